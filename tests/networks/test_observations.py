"""Observation encoders: what they tell apart, and that storage types do not matter."""

import pytest
import torch
import torchvision

from lerobot_lisa.networks.backbones import Backbone, ResnetMap
from lerobot_lisa.networks.observations import ObservationEncoder, ObservationSpec

GRID, DIRECTION = ObservationSpec("symbols", (5,), 8), ObservationSpec("symbols", (1,), 8)
STATE, IMAGE = ObservationSpec("state", (2, 3)), ObservationSpec("image", (3, 12, 9))


def frames(count: int = 4) -> dict[str, torch.Tensor]:
    return {
        "observation.grid": torch.randint(0, 8, (count, 5), dtype=torch.uint8),
        "observation.direction": torch.randint(0, 4, (count, 1), dtype=torch.uint8),
        "observation.state": torch.randn(count, 2, 3),
        "observation.images.front": torch.randint(0, 256, (count, 3, 12, 9), dtype=torch.uint8),
    }


NAMES = torch.zeros(0, 16)  # vectors of what symbols are called: nothing has a name


def whole(encoder: ObservationEncoder, observations: dict[str, torch.Tensor]) -> torch.Tensor:
    """What the encoder makes of frames as a whole, (N, D)."""
    return encoder(observations, NAMES).summary


SPECS = dict(zip(frames(), (GRID, DIRECTION, STATE, IMAGE), strict=True))


def test_every_feature_counts() -> None:
    encoder, base = ObservationEncoder(SPECS, 16), frames()
    out = whole(encoder, base)
    assert out.shape == (4, 16)
    for key in SPECS:
        changed = {**base, key: base[key].roll(1, 0)}
        assert not torch.allclose(whole(encoder, changed), out), key


def test_training_types_and_rollout_types_give_the_same() -> None:
    """The store holds uint8; LeRobot's loader gives int64, environments float32, pictures in 0..1."""
    encoder, stored = ObservationEncoder(SPECS, 16), frames()
    live = {key: value.float() / (255 if "images" in key else 1) for key, value in stored.items()}
    loaded = {**live, "observation.grid": stored["observation.grid"].long()}

    torch.testing.assert_close(whole(encoder, stored), whole(encoder, live))
    torch.testing.assert_close(whole(encoder, stored), whole(encoder, loaded))


def test_a_symbol_means_something_else_elsewhere() -> None:
    encoder = ObservationEncoder({"observation.grid": GRID}, 16)
    rows = torch.tensor([[1, 2, 0, 0, 0], [2, 1, 0, 0, 0], [0, 0, 0, 1, 2]])

    a, b, c = whole(encoder, {"observation.grid": rows})

    assert not torch.allclose(a, b)
    assert not torch.allclose(a, c)


def test_unknown_symbols_count_as_the_last() -> None:
    encoder = ObservationEncoder({"observation.direction": DIRECTION}, 16)

    out = whole(encoder, {"observation.direction": torch.tensor([[7.0], [8.0], [255.0], [0.0], [-3.0]])})

    torch.testing.assert_close(out[1:3], out[:1].expand(2, -1))
    torch.testing.assert_close(out[4], out[3])


@pytest.mark.parametrize("size", [(3, 1, 1), (1, 8, 6), (4, 64, 64), (3, 33, 100)])
def test_images_of_any_size(size: tuple[int, int, int]) -> None:
    encoder = ObservationEncoder({"observation.image": ObservationSpec("image", size)}, 16)

    assert whole(encoder, {"observation.image": torch.rand(2, *size)}).shape == (2, 16)


def test_backbones() -> None:
    """Pictures wait as bytes and come as real numbers."""
    backbone = Backbone(ResnetMap(torchvision.models.resnet18()), 512, [0.5] * 3, [0.25] * 3)
    encoder = ObservationEncoder({"observation.images.front": IMAGE}, 16, backbone=backbone).eval()
    stored = frames()["observation.images.front"]

    assert torch.allclose(
        whole(encoder, {"observation.images.front": stored}),
        whole(encoder, {"observation.images.front": stored.float() / 255}),
        atol=1e-5,
    )
