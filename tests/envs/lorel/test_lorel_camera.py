"""Pictures depend on the state and the quality alone, and equal the original's in full quality."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import drawing
import h5py
import numpy as np
import pytest

from dataset_converters.lorel.random_play import scene_digest
from lerobot_lisa.envs.lorel.camera import QUALITIES, Camera, shared_camera
from lerobot_lisa.errors import UserError

SAMPLE = Path(__file__).parents[4] / "shared" / "data" / "lorel" / "data.hdf5"
STATES = np.random.default_rng(0).uniform(-0.2, 0.2, (3, 15))


def test_the_same_state_gives_the_same_picture() -> None:
    drawing.needs_gl()
    with Camera() as one, Camera() as other:
        first = one.frame(STATES[0])
        assert (first.shape, first.dtype) == ((64, 64, 3), np.uint8)
        for state in STATES[1:]:
            assert not np.array_equal(one.frame(state), first)
        np.testing.assert_array_equal(one.frame(STATES[0]), first)
        np.testing.assert_array_equal(other.frame(STATES[0].astype(np.float32)), first)


def test_drawing_leaves_the_shared_model_as_it_was() -> None:
    """Else a collection that has drawn would take its own unfinished shards for another world's."""
    drawing.needs_gl()
    before = scene_digest("original")
    with Camera("full") as camera:
        camera.frame(STATES[0])
    assert scene_digest("original") == before


def test_qualities_side_by_side() -> None:
    drawing.needs_gl()
    cameras = {name: shared_camera(name, 32, "original") for name in ("minimal", "smooth")}
    before = {name: camera.frame(STATES[0]) for name, camera in cameras.items()}
    after = {name: camera.frame(STATES[0]) for name, camera in cameras.items()}
    assert not np.array_equal(before["minimal"], before["smooth"])
    for name in cameras:
        np.testing.assert_array_equal(before[name], after[name])


@pytest.mark.skipif(not SAMPLE.exists(), reason=f"no sample of the original data at {SAMPLE}")
@pytest.mark.slow
def test_full_quality_is_the_originals() -> None:
    drawing.needs_gl()
    with h5py.File(SAMPLE) as file:
        state, original = file["sim/state"][2, 0], file["sim/ims"][2, 0] * 255
    with Camera("full") as camera:
        assert np.abs(camera.frame(state) - original).mean() < 2


def test_another_thread_is_told_so() -> None:
    drawing.needs_gl()
    with Camera(size=16) as camera, ThreadPoolExecutor(1) as pool:
        camera.frame(STATES[0])
        with pytest.raises(UserError, match="a LOReL camera draws in one thread"):
            pool.submit(camera.frame, STATES[0]).result()
        assert camera.frame(STATES[0]).max() > 0


def test_refusals() -> None:
    with pytest.raises(UserError, match="no image quality 'best'"):
        Camera("best")
    for size in (999, 64.0, "64", True):
        with pytest.raises(UserError, match=f"an image of {size} x {size} pixels: give a whole number from 16 to 480"):
            Camera(size=size)


def test_named_qualities() -> None:
    assert list(QUALITIES) == ["minimal", "smooth", "full"]
