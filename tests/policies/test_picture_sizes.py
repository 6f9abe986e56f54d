"""A camera of another size than the dataset's: pictures become as large as in training."""

import logging
from pathlib import Path
from typing import Any

import pytest
import tiny_datasets
import torch
from hypothesis import given
from hypothesis import strategies as st
from lerobot.configs import FeatureType, NormalizationMode, PolicyFeature, PreTrainedConfig
from tiny_policies import Training, config, training

from lerobot_lisa.episodes.pictures import resize
from lerobot_lisa.policies.shown_pictures import ShownPictures

BOTH = pytest.mark.parametrize("kind", ["lisa", "lang_dt"])
CAMERA = "observation.images.front"
SIDE = st.integers(1, 60)


def recording(folder: Path, height: int = 24, width: int = 32) -> Path:
    """One camera and an arm."""
    camera = {"dtype": "image", "shape": (height, width, 3), "names": ["height", "width", "channels"]}
    arm = {"dtype": "float32", "shape": (2,), "names": ["a", "b"]}
    return tiny_datasets.write(folder, {"observation.state": arm, CAMERA: camera, "action": arm}, lengths=[5, 8])


def seen(made: Training, height: int, width: int) -> tuple[int, ...]:
    """Shape of what the first convolution gets to see of a camera of that size."""
    shapes: list[tuple[int, ...]] = []
    looking = next(layer for layer in made.policy.network.observations.modules() if isinstance(layer, torch.nn.Conv2d))
    hook = looking.register_forward_hook(lambda _, given, __: shapes.append(tuple(given[0].shape[-2:])))
    shown = {"observation.state": torch.zeros(1, 2), CAMERA: torch.rand(1, 3, height, width), "task": ["go"]}
    made.policy.reset()
    made.policy.select_action(made.preprocessor(shown))
    hook.remove()
    return shapes[0]


@BOTH
@pytest.mark.parametrize(
    ("size", "camera", "expected", "said"),
    [
        (16, (24, 32), (12, 16), 0),  # the dataset's own
        (16, (72, 96), (12, 16), 0),  # a finer one of the same shape
        (128, (72, 96), (24, 32), 0),  # which was too small to be made smaller in training
        (None, (72, 96), (24, 32), 0),
        (16, (12, 16), (12, 16), 0),  # made smaller by the robot
        (16, (36, 64), (9, 16), 1),  # wider: as long as in training, nothing is distorted
        (128, (6, 8), (24, 32), 1),  # too coarse
    ],
)
def test_a_rollout_shows_pictures_as_large_as_training_did(
    kind: str,
    size: int | None,
    camera: tuple[int, int],
    expected: tuple[int, int],
    said: int,
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
) -> None:
    made = training(kind, recording(tmp_path / "data"), image_size=size).warm_up()
    with caplog.at_level(logging.WARNING):
        assert [seen(made, *camera) for _ in range(2)] == [expected] * 2

    warnings = [line for line in caplog.messages if "shows pictures of" in line]
    assert len(warnings) == said
    if said:
        assert (
            f"`{CAMERA}` shows pictures of {camera[0]} x {camera[1]} pixels, the policy was trained on 24 x 32: "
            in (warnings[0])
        )
        assert warnings[0].endswith("set the camera to 24 x 32")


@given(height=SIDE, width=SIDE, recorded=st.tuples(SIDE, SIDE), size=st.none() | SIDE)
def test_the_longer_side_is_that_of_training(
    height: int, width: int, recorded: tuple[int, int], size: int | None
) -> None:
    feature = PolicyFeature(FeatureType.VISUAL, (3, *recorded))
    pictures = torch.randint(0, 256, (2, 3, height, width), dtype=torch.uint8)

    shown = ShownPictures(config("lisa", image_size=size)).as_trained(CAMERA, pictures, feature)

    trained = resize(torch.zeros(3, *recorded, dtype=torch.uint8), size).shape[-2:]
    assert max(shown.shape[-2:]) == max(trained)
    if (height, width) == recorded:
        assert torch.equal(shown, resize(pictures, size))


def test_pictures_that_the_preprocessor_scales_stay_numbers(tmp_path: Path) -> None:
    scaled: dict[str, Any] = {"normalization_mapping": {"VISUAL": NormalizationMode.MEAN_STD}}
    made = training("lisa", recording(tmp_path / "data"), **scaled).warm_up()
    feature, shown = made.policy.config.input_features[CAMERA], torch.full((1, 3, 48, 64), -1.5)

    assert torch.equal(made.policy._pictures.as_trained(CAMERA, shown, feature), shown[..., :24, :32])
    assert seen(made, 48, 64) == (24, 32)


def test_fine_tuning_with_another_camera(tmp_path: Path) -> None:
    """From then on pictures are shown as the new recordings are."""
    first = training("lang_dt", recording(tmp_path / "first")).warm_up()
    for part in (first.policy, first.preprocessor, first.postprocessor):
        part.save_pretrained(tmp_path / "checkpoint")
    tuned = Training(_pretrained(tmp_path / "checkpoint"), recording(tmp_path / "second", 48, 48)).warm_up()

    assert tuned.policy.gather(tuned.batch([0]))[0][CAMERA].shape[-2:] == (48, 48)
    assert seen(tuned, 48, 48) == (48, 48)


def _pretrained(checkpoint: Path) -> Any:
    found = PreTrainedConfig.from_pretrained(checkpoint)
    found.pretrained_path = checkpoint
    return found
