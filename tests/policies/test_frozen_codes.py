"""Codes that a policy keeps from the checkpoint that its training starts from."""

import copy
from pathlib import Path

import pytest
import torch
from lerobot.configs import PreTrainedConfig
from tiny_policies import Training, training

from lerobot_lisa.errors import UserError
from lerobot_lisa.policies.lisa.configuration_lisa import LisaConfig


def learn(made: Training, steps: int = 3) -> None:
    optimizer = torch.optim.Adam(made.policy.get_optim_params(), lr=0.01)
    made.policy.train()
    for _ in range(steps):
        made.policy.forward(made.batch(made.first_frames()))[0].backward()
        optimizer.step()
        optimizer.zero_grad()


def test_not_one_number_of_the_codebook_moves(symbolic: Path, tmp_path: Path) -> None:
    training("lisa", symbolic, copy_words=False).warm_up().policy.save_pretrained(tmp_path)
    config = PreTrainedConfig.from_pretrained(tmp_path)
    config.pretrained_path, config.freeze_codebook = tmp_path, True
    made = Training(config, symbolic)
    before = copy.deepcopy(made.policy.state_dict())

    learn(made)

    moved = {key for key, value in made.policy.state_dict().items() if not torch.equal(value, before[key])}
    assert not [key for key in moved if ".quantizer." in key]
    assert [key for key in moved if ".predictor." in key]
    assert [key for key in moved if ".action_predictor." in key]
    assert len([key for key in before if ".quantizer." in key]) > 3


def test_there_must_be_codes_to_keep(symbolic: Path) -> None:
    with pytest.raises(UserError, match="there are none yet: start from a checkpoint that has codes"):
        learn(training("lisa", symbolic, freeze_codebook=True))


def test_continuous_skills_have_none() -> None:
    with pytest.raises(UserError, match="continuous skills have no codebook to freeze"):
        LisaConfig(freeze_codebook=True, quantizer="continuous", device="cpu")
