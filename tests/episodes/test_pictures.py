"""Pictures are LeRobot's own, made smaller as rollouts make them; decoded once, when asked for, and kept."""

import errno
import logging
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
import recordings
import torch
from hypothesis import given
from hypothesis import strategies as st
from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.datasets.video_utils import decode_video_frames

from lerobot_lisa.episodes import pictures_on_disk, progress
from lerobot_lisa.episodes.load import load_episodes
from lerobot_lisa.episodes.pictures import resize, resized_shape
from lerobot_lisa.episodes.pictures_on_disk import PicturesOnDisk
from lerobot_lisa.episodes.sources import VideoSource
from lerobot_lisa.episodes.store import EpisodeStore
from lerobot_lisa.episodes.video import frames_at
from lerobot_lisa.errors import UserError

TOP, WRIST = recordings.CAMERAS
SIDE = st.integers(1, 90)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two cameras as video; episodes of 9, 4 and 13 frames."""
    return recordings.record(tmp_path_factory.mktemp("recorded") / "data")


@pytest.fixture
def videos(recorded: Path, tmp_path: Path) -> Path:
    """A copy, which has no pictures on disk yet."""
    return Path(shutil.copytree(recorded, tmp_path / "data"))


def load(root: Path, size: int | None = 16, keys: tuple[str, ...] = (TOP, WRIST, "action")) -> EpisodeStore:
    return load_episodes(LeRobotDatasetMetadata("local/tiny", root=root), keys, image_size=size)


def decoded(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, int]]:
    """Notes which camera's episodes are read from now on."""
    seen: list[tuple[str, int]] = []
    read = VideoSource.read

    def noted(self: VideoSource, first: int, last: int) -> Iterator[Any]:
        seen.extend((self._key, episode) for episode in range(first, last + 1))
        return read(self, first, last)

    monkeypatch.setattr(VideoSource, "read", noted)
    return seen


@pytest.mark.parametrize("size", [None, 16, 640])
@pytest.mark.parametrize("kind", ["videos", "pictures"])
def test_lerobots_own_frames_made_smaller(kind: str, size: int | None, request: pytest.FixtureRequest) -> None:
    root = request.getfixturevalue(kind)
    dataset = LeRobotDataset("local/tiny", root=root, video_backend="pyav", return_uint8=True)
    keys = tuple(dataset.meta.camera_keys)
    columns, _ = load(root, size, keys).gather(torch.arange(dataset.num_episodes))
    for i in range(len(dataset)):
        item = dataset[i]
        for key in keys:
            assert torch.equal(columns[key][i], resize(item[key], size)), (key, i)


def test_only_what_is_asked_for_is_decoded_and_only_once(videos: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen = decoded(monkeypatch)
    store = load(videos)
    assert seen == []
    first, _ = store.gather(torch.tensor([2, 0, 2]))
    assert sorted(seen) == [(TOP, 0), (TOP, 2), (WRIST, 0), (WRIST, 2)]
    seen.clear()
    again, _ = load(videos).gather(torch.tensor([2, 0, 2]))  # another run
    load(videos, keys=(TOP, "action")).gather(torch.tensor([0, 2]))  # of one of the cameras
    assert seen == []
    assert all(torch.equal(first[key], again[key]) for key in first)
    load(videos, size=20).gather(torch.tensor([0]))
    load(videos, keys=(TOP,)).to("cpu")  # which wants everything there
    assert sorted(seen) == [(TOP, 0), (TOP, 1), (WRIST, 0)]


def test_what_an_interrupted_run_has_decoded_remains(videos: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of three episodes, the second is interrupted after two frames."""
    read = VideoSource.read

    def interrupted(self: VideoSource, first: int, last: int) -> Iterator[Any]:
        for i, picture in enumerate(read(self, first, last)):
            if i == 11:
                raise KeyboardInterrupt
            yield picture

    with monkeypatch.context() as patch:
        patch.setattr(VideoSource, "read", interrupted)
        with pytest.raises(KeyboardInterrupt):
            load(videos, keys=(TOP,)).gather(torch.arange(3))
    seen = decoded(monkeypatch)
    resumed, _ = load(videos, keys=(TOP,)).gather(torch.arange(3))
    assert seen == [(TOP, 1), (TOP, 2)]
    assert torch.equal(resumed[TOP], load(Path(shutil.copytree(videos, f"{videos}_2"))).gather(torch.arange(3))[0][TOP])


def test_a_short_stretch_is_decoded_at_a_time(videos: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole, _ = load(videos).gather(torch.arange(3))
    monkeypatch.setattr(pictures_on_disk, "_FRAMES_AT_ONCE", 1)
    cut, _ = load(Path(shutil.copytree(videos, f"{videos}_2"))).gather(torch.arange(3))
    assert all(torch.equal(whole[key], cut[key]) for key in whole)


def test_lines_for_the_log_where_there_is_no_terminal(
    videos: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(progress, "SECONDS_BETWEEN_LINES", 0.0)
    with caplog.at_level(logging.INFO):
        load(videos).gather(torch.arange(3))
    assert "Decoding pictures: 52 of 52 frames" in caplog.text


def only_video(root: Path, camera: str = TOP) -> Path:
    (path,) = (root / "videos" / camera).rglob("*.mp4")
    return path


@pytest.mark.parametrize(("damage", "message"), [("gone", "No such file"), ("half", ""), ("other", "has no frame at")])
def test_a_video_that_is_not_what_it_should_be(damage: str, message: str, videos: Path) -> None:
    path = only_video(videos)
    if damage == "half":
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    elif damage == "other":
        shutil.copy(only_video(recordings.record(videos.parent / "short", (2,))), path)
    else:
        path.unlink()
    with pytest.raises(UserError, match=f"file-000.mp4: .*{message}.*: fetch the dataset again") as refused:
        load(videos).gather(torch.tensor([2]))
    assert "\n" not in str(refused.value)


def test_pictures_of_another_size_than_promised(videos: Path) -> None:
    meta = LeRobotDatasetMetadata("local/tiny", root=videos)
    meta.features[TOP]["shape"] = (24, 32, 3)
    with pytest.raises(UserError, match=r"`observation.images.top` of frame 0 is of shape \(3, 48, 64\)"):
        PicturesOnDisk(meta, [TOP], None).fetch([0])
    meta.features[TOP]["shape"] = (24, 32, 4)
    with pytest.raises(UserError, match="holds no pictures of one or three colours"):
        PicturesOnDisk(meta, [TOP], None)


def test_a_disk_that_fills_up(videos: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    seen, store = decoded(monkeypatch), load(videos)
    with monkeypatch.context() as patch:
        patch.setattr("lerobot_lisa.episodes.disk.os.posix_fallocate", full)
        with pytest.raises(UserError, match=r"cannot keep 0.0 GB of the episode store there \(No space left"):
            store.gather(torch.tensor([0]))
    assert seen == []
    store.gather(torch.tensor([0]))


@pytest.fixture(scope="module")
def long_groups(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A video with a key frame every 25 frames, and frames in between that refer to later ones."""
    path = tmp_path_factory.mktemp("video") / "long.mp4"
    rng = np.random.default_rng(0)
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libsvtav1", rate=30, options={"g": "25", "preset": "10"})
        stream.width, stream.height, stream.pix_fmt = 64, 64, "yuv420p"
        picture = rng.integers(0, 256, (64, 64, 3), dtype=np.uint8)
        for _ in range(60):
            picture = np.roll(picture, 2, axis=1)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        container.mux(stream.encode())
    return path


@given(st.lists(st.integers(0, 59), min_size=1, max_size=6))
def test_any_frames_of_a_video(long_groups: Path, frames: list[int]) -> None:
    times = [frame / 30 for frame in sorted(frames)]
    ours = np.stack(list(frames_at(long_groups, times, 0.01)))
    theirs = decode_video_frames(long_groups, times, 1e-3, "pyav", return_uint8=True)
    np.testing.assert_array_equal(ours, theirs.permute(0, 2, 3, 1).numpy())


@given(SIDE, SIDE, SIDE, st.integers(0, 3))
def test_resizing_keeps_the_aspect_and_needs_no_batch(height: int, width: int, size: int, more: int) -> None:
    pictures = torch.randint(0, 256, (*[2] * more, 3, height, width), dtype=torch.uint8)
    small = resize(pictures, size)
    assert (small.dtype, small.shape[:-2]) == (torch.uint8, pictures.shape[:-2])
    assert small.shape[-2:] == resized_shape(height, width, size)
    assert max(small.shape[-2:]) == min(size, max(height, width))
    if max(height, width) > size:
        shrink, (shorter, original) = max(height, width) / size, (min(small.shape[-2:]), min(height, width))
        assert abs(shorter - original / shrink) <= 0.5 or (shorter == 1 and original < shrink)
    one = resize(pictures.reshape(-1, 3, height, width)[-1], size)
    assert torch.equal(one, small.reshape(-1, *small.shape[-3:])[-1])
    assert torch.equal(resize(pictures.float() / 255, size), small)  # as a rollout has them


def test_a_plain_colour_stays_what_it_is() -> None:
    colour = torch.tensor([10, 100, 250], dtype=torch.uint8)[:, None, None]
    assert torch.equal(resize(colour.expand(3, 480, 640), 128), colour.expand(3, 96, 128))
