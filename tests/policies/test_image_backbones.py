"""Pretrained image backbones: one that works, and every way to name one that does not."""

import pytest
import torch
from lerobot.configs import FeatureType, PolicyFeature

from lerobot_lisa import LisaConfig
from lerobot_lisa.errors import UserError
from lerobot_lisa.policies.parts import make_language_encoder, make_observation_encoder
from lerobot_lisa.policies.vision import make_backbone


def config(channels: int, **settings: str) -> LisaConfig:
    image = PolicyFeature(FeatureType.VISUAL, (channels, 64, 64))
    return LisaConfig(device="cpu", language_encoder="words", input_features={"observation.image": image}, **settings)


def test_a_resnet_embeds_images() -> None:
    settings = config(3, vision_backbone="resnet18")
    encoder = make_observation_encoder(settings, make_language_encoder(settings), make_backbone(settings)).eval()

    seen = encoder({"observation.image": torch.rand(2, 3, 64, 64)}, torch.zeros(0, 128))

    assert seen.summary.shape == (2, 128)
    assert [keys.vectors.shape for keys in seen.parts.keys] == [(2, 49, 128)]


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
        make_backbone(config(channels, **settings))
    assert "\n" not in str(caught.value)
