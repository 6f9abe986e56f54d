"""LISA with one observation encoder for skill predictor and policy."""

from pathlib import Path

import torch
from lerobot.policies.factory import get_policy_class
from tiny_policies import training
from torch import nn


def count(module: nn.Module) -> int:
    return sum(parameter.numel() for parameter in module.parameters())


def test_one_encoder_less(pictures: Path) -> None:
    apart = training("lisa", pictures, shared_observation_encoder=False).policy
    shared = training("lisa", pictures, shared_observation_encoder=True).policy

    assert shared.network.predictor_observations is None
    assert count(apart) - count(shared) == count(shared.network.observations) > 0


def test_an_image_is_encoded_once_and_both_levels_teach_the_encoder(pictures: Path) -> None:
    made = training("lisa", pictures, shared_observation_encoder=True, dropout=0.0).warm_up()
    encoder, passes = made.policy.network.observations, []
    encoder.register_forward_hook(lambda module, args, out: passes.append(len(out)))
    batch = made.batch(made.first_frames())

    made.policy.forward(batch)[0].backward()
    both = encoder.encoders["observation_images_front"].output.weight.grad.clone()
    made.policy.zero_grad()
    made.policy.network.predictor.register_forward_hook(lambda module, args, out: out.detach())
    made.policy.forward(batch)[0].backward()
    policy_alone = encoder.encoders["observation_images_front"].output.weight.grad

    assert len(passes) == 2
    assert not torch.allclose(both, policy_alone)


def test_every_parameter_learns_at_one_rate_and_comes_back_from_a_checkpoint(pictures: Path, tmp_path: Path) -> None:
    policy = training("lisa", pictures, shared_observation_encoder=True).warm_up().policy
    grouped = [id(parameter) for group in policy.get_optim_params() for parameter in group["params"]]
    assert sorted(grouped) == sorted(id(parameter) for parameter in policy.parameters())

    policy.save_pretrained(tmp_path)
    loaded = get_policy_class("lisa").from_pretrained(tmp_path, strict=True)

    assert loaded.network.predictor_observations is None
    assert all(torch.equal(value, loaded.state_dict()[key]) for key, value in policy.state_dict().items())
