"""Pretrained image backbones: one that works, and every way to name one that does not."""

import pytest
import torch
from lerobot.configs import FeatureType, PolicyFeature

from lerobot_lisa import LisaConfig
from lerobot_lisa.errors import UserError
from lerobot_lisa.policies.parts import make_observation_encoder


def config(channels: int, **settings: str) -> LisaConfig:
    image = PolicyFeature(FeatureType.VISUAL, (channels, 64, 64))
    return LisaConfig(device="cpu", input_features={"observation.image": image}, **settings)


def test_a_resnet_embeds_images() -> None:
    encoder = make_observation_encoder(config(3, vision_backbone="resnet18")).eval()

    assert encoder({"observation.image": torch.rand(2, 3, 64, 64)}).shape == (2, 128)


@pytest.mark.parametrize(
    ("channels", "settings", "message"),
    [
        (3, {"vision_backbone": "resnet19"}, "resnet19"),
        (1, {"vision_backbone": "resnet18"}, "needs 3 channels"),
        (3, {"vision_backbone": "vit_b_16"}, "choose a resnet"),
        (3, {"vision_backbone": "resnet18", "pretrained_backbone_weights": "NO_SUCH"}, "NO_SUCH"),
    ],
)
def test_others_are_refused_in_one_line(channels: int, settings: dict[str, str], message: str) -> None:
    with pytest.raises(UserError, match=message) as caught:
        make_observation_encoder(config(channels, **settings))
    assert "\n" not in str(caught.value)
