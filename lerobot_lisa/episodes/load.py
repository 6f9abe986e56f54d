"""Fill an episode store from a LeRobotDataset: numbers straight from parquet, pictures when they are asked for."""

import logging
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import psutil
import torch

from lerobot_lisa.episodes.check import FrameLedger, bounds, check_metadata
from lerobot_lisa.episodes.disk import Allocate, clear_abandoned, mapped_columns
from lerobot_lisa.episodes.features_on_disk import FeaturesOnDisk, Looker
from lerobot_lisa.episodes.pictures_on_disk import PicturesOnDisk
from lerobot_lisa.episodes.runs import task_runs
from lerobot_lisa.episodes.store import EpisodeStore
from lerobot_lisa.episodes.tables import Array, tables, values
from lerobot_lisa.errors import UserError

if TYPE_CHECKING:
    from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata

_SHARE_OF_MEMORY = 0.5  # of what is free; the rest is for training


def load_episodes(
    meta: "LeRobotDatasetMetadata",
    keys: Sequence[str],
    location: str = "memory",
    image_size: int | None = None,
    looker: Looker | None = None,
) -> EpisodeStore:
    """Read features of every frame of a dataset that is on disk under `meta.root`.

    Pictures are decoded when an episode is first asked for, and kept for later runs (`pictures_on_disk`). Of a dataset
    that was fetched in part (`--dataset.episodes`), the episodes of the missing files are left out; asking the store
    for one of them is an error.

    Args:
        meta: The dataset.
        keys: Features to read.
        location: Where numbers are: "memory", or "disk" for files that are mapped into memory and shared between
            processes. What does not fit into memory goes to disk by itself.
        image_size: Pixels of the longer side of pictures; None keeps them as they are.
        looker: Makes features of pictures, which take their place; None: the store holds pictures.

    Returns:
        The store; an episode of it is a run of frames with one task.

    Raises:
        UserError: The dataset lacks a feature, or the files do not hold the frames that the metadata promises.
    """
    clear_abandoned()
    starts, stops = check_metadata(meta, keys)
    ledger = FrameLedger(meta.root, starts, stops, _present_episodes(meta))
    shown = [key for key in keys if meta.features[key]["dtype"] in ("image", "video")]
    numbers = [key for key in keys if key not in shown]
    if location == "disk" or not _fits_memory(meta, numbers):
        columns = mapped_columns(Path(meta.root), numbers, lambda allocate: _read(meta, numbers, allocate, ledger))
    else:
        columns = _read(meta, numbers, lambda _, shape, dtype: np.empty(shape, dtype), ledger)
    pictures = PicturesOnDisk(meta, shown, image_size)
    seen = pictures if looker is None else FeaturesOnDisk(meta, pictures, looker)
    tensors = {key: torch.from_numpy(column) for key, column in {**columns, **seen.columns}.items()}
    runs = task_runs(meta)
    return EpisodeStore(tensors, runs.starts, runs.lengths, ledger.present[runs.episodes], runs.episodes, seen.fetch)


def _of_episodes(meta: "LeRobotDatasetMetadata", column: str) -> Array:
    """(episodes,) numbers of the metadata; asked for at once, because one after another takes a dozen times as long."""
    return np.asarray(meta.episodes[column][:])


def _present_episodes(meta: "LeRobotDatasetMetadata") -> Array:
    """(episodes,) whether the file that holds an episode's numbers is there."""
    places = np.stack([_of_episodes(meta, f"data/{part}_index") for part in ("chunk", "file")], axis=1)
    files, which = np.unique(places, axis=0, return_inverse=True)
    there = [_data_file(meta, *place).is_file() for place in files.tolist()]
    if not any(there):
        raise UserError(f"{meta.root}: none of the dataset's {len(there)} data files is there: fetch it again")
    return np.array(there)[which.reshape(-1)]


def _data_file(meta: "LeRobotDatasetMetadata", chunk: int, file: int) -> Path:
    """Where LeRobot keeps some episodes."""
    try:
        path = Path(meta.root) / meta.data_path.format(chunk_index=chunk, file_index=file)
        path.resolve().relative_to(Path(meta.root).resolve())
    except (LookupError, ValueError, AttributeError, TypeError, MemoryError):
        raise UserError(f"{meta.root}: meta/info.json: data_path is no place in the dataset: fetch it again") from None
    return path


def _fits_memory(meta: "LeRobotDatasetMetadata", keys: Sequence[str]) -> bool:
    size = sum(meta.total_frames * math.prod(meta.features[key]["shape"]) * _dtype(meta, key).itemsize for key in keys)
    free = psutil.virtual_memory().available
    if size <= _SHARE_OF_MEMORY * free:
        return True
    logging.info("%s: %.1f GB of frames are memory-mapped, %.1f GB are free", meta.root, size / 1e9, free / 1e9)
    return False


def _dtype(meta: "LeRobotDatasetMetadata", key: str) -> np.dtype:
    return np.dtype(meta.features[key]["dtype"])


def _read(
    meta: "LeRobotDatasetMetadata", keys: Sequence[str], allocate: Allocate, ledger: FrameLedger
) -> dict[str, Array]:
    """Columns of numbers of all frames; those of episodes that are not present stay as they were allocated."""
    shapes = {key: (meta.total_frames, *meta.features[key]["shape"]) for key in keys}
    columns = {key: allocate(key, shape, _dtype(meta, key)) for key, shape in shapes.items()}
    allowed = {key: bounds(meta, key) for key in keys}
    for path, table in tables(Path(meta.root), [*keys, "index", "episode_index"]):
        frames = values(path, table, "index")
        rows = ledger.note(frames, values(path, table, "episode_index"))
        for key, column in columns.items():
            numbers = values(path, table, key, column.shape[1:])
            ledger.check_values(key, numbers, frames, allowed[key])
            column[rows] = numbers
    ledger.check_complete()
    return columns
