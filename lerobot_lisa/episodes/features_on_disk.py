"""What a frozen backbone says of a dataset's pictures, kept beside them: it is asked once for each frame.

As with the pictures, features are computed when an episode is first asked for, and kept for later runs.
"""

from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import torch
from torch import Tensor

from lerobot_lisa.episodes.check import episode_spans
from lerobot_lisa.episodes.disk import kept_folder, sparse_array, take_room
from lerobot_lisa.episodes.pictures_on_disk import PicturesOnDisk
from lerobot_lisa.episodes.progress import FrameProgress
from lerobot_lisa.episodes.tables import Array

if TYPE_CHECKING:
    from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata

_AT_ONCE = 64  # pictures that are encoded together


class Looker(NamedTuple):
    """Who is asked.

    Attributes:
        encode: Pictures, bytes (N, channels, height, width), to features (N, *shape).
        shape: Of the features of one picture.
        fingerprint: Changes with whatever changes them.
    """

    encode: Callable[[Tensor], Tensor]
    shape: tuple[int, ...]
    fingerprint: str


class FeaturesOnDisk:
    """Features of the pictures of some features of a dataset.

    Attributes:
        columns: By feature, float32 (frames, *shape); zeros until they are fetched.
    """

    def __init__(self, meta: "LeRobotDatasetMetadata", pictures: PicturesOnDisk, looker: Looker) -> None:
        """Open the files, or make empty ones.

        Raises:
            UserError: The files cannot be written.
        """
        self._pictures, self._looker = pictures, looker
        self._starts, self._stops = episode_spans(meta)
        self._folders = {
            key: self._folder(Path(meta.root), key, shown.shape) for key, shown in pictures.columns.items()
        }
        self.columns: dict[str, Array] = {
            key: np.load(folder / "features.npy", mmap_mode="r+") for key, folder in self._folders.items()
        }
        self._done = {key: np.load(folder / "done.npy", mmap_mode="r+") for key, folder in self._folders.items()}

    def _folder(self, root: Path, key: str, shape: tuple[int, ...]) -> Path:
        def make(folder: Path) -> None:
            sparse_array(folder / "features.npy", (shape[0], *self._looker.shape), np.dtype(np.float32))
            sparse_array(folder / "done.npy", (len(self._starts),), np.dtype(np.bool_))

        return kept_folder(root, [key, f"pictures {shape}", f"features {self._looker.fingerprint}"], make)

    def fetch(self, episodes: Sequence[int]) -> None:
        """Have the features of some episodes of the dataset.

        Raises:
            UserError: A picture is missing or cannot be decoded, or the disk is full.
        """
        wanted = np.unique(np.asarray(episodes, np.int64))
        work = [(key, episode) for key, done in self._done.items() for episode in wanted[~done[wanted]].tolist()]
        if not work:
            return
        self._pictures.fetch(sorted({episode for _, episode in work}))
        frames = sum(int(self._stops[episode] - self._starts[episode]) for _, episode in work)
        with closing(FrameProgress("Looking at pictures", frames)) as progress:
            for key, episode in work:
                self._look(key, episode, progress)

    def _look(self, key: str, episode: int, progress: FrameProgress) -> None:
        start, stop = int(self._starts[episode]), int(self._stops[episode])
        pictures, column = self._pictures.columns[key], self.columns[key]
        take_room(self._folders[key] / "features.npy", column, start, stop)
        for at in range(start, stop, _AT_ONCE):
            part = slice(at, min(at + _AT_ONCE, stop))
            column[part] = self._looker.encode(torch.from_numpy(pictures[part])).cpu().numpy()
            progress.add(part.stop - part.start)
        self._done[key][episode] = True
