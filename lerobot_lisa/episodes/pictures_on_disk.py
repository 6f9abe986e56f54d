"""A dataset's pictures as small bytes in memory-mapped files, decoded once, when an episode is first asked for.

`--dataset.episodes` and `--dataset.eval_split` are not told to policies: waiting for what is drawn decodes nothing that
nobody asks for, and training begins at once. What has been decoded is kept for later runs, whatever ends this one.
"""

import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import torch

from lerobot_lisa.episodes.check import episode_spans
from lerobot_lisa.episodes.disk import kept_folder, sparse_array, take_room
from lerobot_lisa.episodes.pictures import resize, resized_shape
from lerobot_lisa.episodes.progress import FrameProgress
from lerobot_lisa.episodes.sources import picture_source, stored_shape
from lerobot_lisa.episodes.tables import Array
from lerobot_lisa.errors import UserError

if TYPE_CHECKING:
    from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata

_FRAMES_AT_ONCE = 512  # of neighbouring episodes: a long video takes some time to open


class PicturesOnDisk:
    """Pictures of some features.

    Attributes:
        columns: By feature, bytes (frames, channels, height, width); zeros until they are fetched.
    """

    def __init__(self, meta: "LeRobotDatasetMetadata", keys: Sequence[str], size: int | None) -> None:
        """Open the files, or make empty ones.

        Args:
            meta: The dataset.
            keys: Features of type image or video.
            size: Pixels of the longer side; None keeps pictures as they are.

        Raises:
            UserError: A feature holds something else than pictures, or the files cannot be written.
        """
        self._cameras = [_Camera(meta, key, size) for key in keys]
        self.columns: dict[str, Array] = {camera.key: camera.pictures for camera in self._cameras}

    def fetch(self, episodes: Sequence[int]) -> None:
        """Decode what has not been decoded of some episodes of the dataset.

        Raises:
            UserError: A picture is missing or cannot be decoded, or the disk is full.
        """
        wanted = np.unique(np.asarray(episodes, np.int64))
        work = [stretch for camera in self._cameras for stretch in camera.missing(wanted)]
        if work:
            for stretch in work:
                stretch.camera.take_room(stretch)
            _decode(work)

    def forget(self) -> None:
        """Have everything decoded anew when it is asked for."""
        for camera in self._cameras:
            camera.forget()


class _Stretch(NamedTuple):
    """Neighbouring episodes in one file of a camera, from `first` to `last`, which are decoded front to back."""

    camera: "_Camera"
    first: int
    last: int
    frames: int


def _decode(work: Sequence[_Stretch]) -> None:
    """Decode side by side, in threads: PyAV, Pillow and torch let go of Python's lock while they work.

    Processes would each import LeRobot first, for some seconds, and outlive a program that is killed.
    """
    progress, stop = FrameProgress("Decoding pictures", sum(stretch.frames for stretch in work)), Event()
    with ThreadPoolExecutor(len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else None) as pool:
        try:
            for done in as_completed([pool.submit(s.camera.decode, s, progress, stop) for s in work]):
                done.result()
        finally:  # also after Ctrl-C, or at a video that cannot be read
            stop.set()
            pool.shutdown(cancel_futures=True)
            progress.close()


class _Camera:
    """Pictures of one feature."""

    def __init__(self, meta: "LeRobotDatasetMetadata", key: str, size: int | None) -> None:
        self.key, self._root, self._size = key, Path(meta.root), size
        self._shape = stored_shape(meta, key)
        self._starts, self._stops = episode_spans(meta)
        self._source = picture_source(meta, key)
        folder = kept_folder(self._root, [key, f"longer side {size}"], self._make)
        self._path = folder / "pictures.npy"
        # Shared with the files and with other processes that train on the dataset, which would write the same.
        self.pictures: Array = np.load(self._path, mmap_mode="r+")
        self._decoded: Array = np.load(folder / "decoded.npy", mmap_mode="r+")

    def _make(self, folder: Path) -> None:
        frames, shape = int(self._stops[-1]), (self._shape[0], *resized_shape(*self._shape[1:], self._size))
        sparse_array(folder / "pictures.npy", (frames, *shape), np.dtype(np.uint8))
        sparse_array(folder / "decoded.npy", (len(self._starts),), np.dtype(np.bool_))

    def forget(self) -> None:
        """Nothing has been decoded."""
        self._decoded[:] = False

    def missing(self, episodes: Array) -> Iterator[_Stretch]:
        """What is to be decoded of some episodes, which are in order."""
        episodes = episodes[~self._decoded[episodes]]
        lengths, files = (self._stops - self._starts)[episodes], self._source.files[episodes]
        portions = np.cumsum(lengths) // _FRAMES_AT_ONCE
        cut = (np.diff(episodes) != 1) | (np.diff(files) != 0) | (np.diff(portions) != 0)
        for stretch in np.split(np.arange(len(episodes)), np.flatnonzero(cut) + 1):
            if len(stretch):
                yield _Stretch(self, int(episodes[stretch[0]]), int(episodes[stretch[-1]]), int(lengths[stretch].sum()))

    def take_room(self, stretch: _Stretch) -> None:
        """Take the room on the disk that decoded pictures will need."""
        take_room(self._path, self.pictures, int(self._starts[stretch.first]), int(self._stops[stretch.last]))

    def decode(self, stretch: _Stretch, progress: FrameProgress, stop: Event) -> None:
        """Decode a stretch, until `stop` is set; episodes that are complete by then remain."""
        pictures = self._source.read(stretch.first, stretch.last)
        for episode in range(stretch.first, stretch.last + 1):
            for frame in range(self._starts[episode], self._stops[episode]):
                if stop.is_set():
                    return
                self.pictures[frame] = self._small(next(pictures), frame)
            self._decoded[episode] = True
            progress.add(int(self._stops[episode] - self._starts[episode]))

    def _small(self, picture: Array, frame: int) -> Array:
        """(height, width, channels) as it comes to (channels, height, width) as it is kept."""
        tensor = torch.from_numpy(picture).permute(2, 0, 1)
        if tensor.shape != self._shape:
            raise UserError(
                f"{self._root}: `{self.key}` of frame {frame} is of shape {tuple(tensor.shape)}, but meta/info.json "
                f"says {self._shape}: fetch the dataset again"
            )
        return resize(tensor, self._size).numpy()
