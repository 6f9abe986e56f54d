"""LeRobot's image transforms change the pictures of training, an episode at a time, and nothing else."""

from pathlib import Path

import draccus
import pytest
import torch
from lerobot.configs import PreTrainedConfig
from lerobot.transforms import ImageTransformConfig, ImageTransformsConfig
from tiny_policies import Training, training
from torch import Tensor

from lerobot_lisa.errors import UserError
from lerobot_lisa.policies.lisa.configuration_lisa import LisaConfig
from lerobot_lisa.policies.lisa.modeling_lisa import LisaPolicy

CAMERA, STATE = "observation.images.front", "observation.state"
DARKER = ImageTransformsConfig(
    enable=True, tfs={"darker": ImageTransformConfig(1.0, "ColorJitter", {"brightness": (0.2, 0.8)})}
)


@pytest.fixture(params=["lisa", "lang_dt"])
def trained(request: pytest.FixtureRequest, pictures: Path) -> Training:
    """A policy whose training pictures are darkened."""
    return training(request.param, pictures, image_transforms=DARKER)


def seen(trained: Training, episodes: list[int]) -> tuple[list[Tensor], dict[str, Tensor]]:
    """Pictures of each episode, and all frames, as the policy gets them."""
    frames, packing = trained.policy.gather(trained.batch(trained.first_frames(episodes)))
    return list((frames[CAMERA] / 255).split(packing.lengths.tolist())), frames


def test_training_sees_each_episode_in_a_light_of_its_own(trained: Training) -> None:
    trained.policy.eval()
    stored, unchanged = seen(trained, [0, 2, 3])
    trained.policy.train()
    pictures, frames = seen(trained, [0, 2, 3])
    lights = [(changed.sum() / picture.sum()).item() for changed, picture in zip(pictures, stored, strict=True)]
    assert all(0.15 < light < 0.85 for light in lights)
    assert len({round(light, 2) for light in lights}) == 3
    for changed, picture, light in zip(pictures, stored, lights, strict=True):
        assert (changed - light * picture).abs().max() < 0.02  # all frames of an episode alike
    assert torch.equal(frames[STATE], unchanged[STATE])


def test_the_same_step_draws_the_same(trained: Training) -> None:
    trained.policy.train()
    first, _ = seen(trained, [0, 2])
    torch.manual_seed(1)
    again, _ = seen(trained, [0, 2])
    others, _ = seen(trained, [0, 3])
    assert torch.equal(first[0], again[0])
    assert not torch.equal(first[0], others[0])


def test_rollouts_are_shown_what_there_is(pictures: Path) -> None:
    plain, darker = (training("lisa", pictures, image_transforms=each) for each in (ImageTransformsConfig(), DARKER))
    darker.policy.load_state_dict(plain.warm_up().policy.state_dict())
    batch = plain.batch([0])
    assert torch.equal(plain.policy.action_outputs(batch), darker.policy.action_outputs(batch))


def test_settings_are_lerobots(tmp_path: Path) -> None:
    options = ["--image_transforms.enable=true", "--image_transforms.max_num_transforms=2", "--push_to_hub=false"]
    config = draccus.parse(LisaConfig, args=options)
    assert config.image_transforms.enable
    assert config.image_transforms.max_num_transforms == 2
    assert set(config.image_transforms.tfs) == set(ImageTransformsConfig().tfs)
    config.save_pretrained(tmp_path)
    assert PreTrainedConfig.from_pretrained(tmp_path).image_transforms.max_num_transforms == 2


def test_a_transform_that_there_is_not(pictures: Path) -> None:
    unknown = ImageTransformsConfig(enable=True, tfs={"fog": ImageTransformConfig(1.0, "Fog")})
    with pytest.raises(UserError, match=r"--policy\.image_transforms: .*Fog"):
        training("lisa", pictures, image_transforms=unknown)
    acting = training("lisa", pictures).policy.config
    acting.image_transforms = unknown  # of a checkpoint that was trained with a later LeRobot
    LisaPolicy(acting)
