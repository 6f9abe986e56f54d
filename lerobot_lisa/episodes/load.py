"""Fill an episode store from a LeRobotDataset: numbers straight from parquet, pictures through LeRobot's decoder."""

import logging
import math
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import psutil
import pyarrow as pa
import pyarrow.parquet as pq
import torch
from tqdm import tqdm

from lerobot_lisa.episodes.disk import Allocate, Array, mapped_columns
from lerobot_lisa.episodes.store import EpisodeStore
from lerobot_lisa.errors import UserError

if TYPE_CHECKING:
    from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata

_SHARE_OF_MEMORY = 0.5  # of what is free; the rest is for training


def load_episodes(meta: "LeRobotDatasetMetadata", keys: Sequence[str], location: str = "memory") -> EpisodeStore:
    """Read features of every frame of a dataset that is on disk under `meta.root`.

    Of a dataset that was fetched in part (`--dataset.episodes`), the episodes of the missing files are left out; asking
    the store for one of them is an error.

    Args:
        meta: The dataset.
        keys: Features to read.
        location: "memory", or "disk" for files that are mapped into memory and shared between processes. What does not
            fit into memory goes to disk by itself.

    Raises:
        UserError: The dataset lacks a feature, or the files do not hold the frames that the metadata promises.
    """
    _check_keys(meta, keys)
    starts, stops = (_of_episodes(meta, f"dataset_{end}_index") for end in ("from", "to"))
    present = _present_episodes(meta)
    missing = int((stops - starts)[~present].sum())
    if location == "disk" or not _fits_memory(meta, keys):
        columns = mapped_columns(Path(meta.root), keys, lambda allocate: _read(meta, keys, allocate, present, missing))
    else:
        columns = _read(meta, keys, lambda _, shape, dtype: np.empty(shape, dtype), present, missing)
    tensors = {key: torch.from_numpy(column) for key, column in columns.items()}
    return EpisodeStore(tensors, starts, stops - starts, present)


def _of_episodes(meta: "LeRobotDatasetMetadata", column: str) -> Array:
    """(episodes,) numbers of the metadata; asked for at once, because one after another takes a dozen times as long."""
    return np.asarray(meta.episodes[column][:])


def _check_keys(meta: "LeRobotDatasetMetadata", keys: Sequence[str]) -> None:
    for key in keys:
        if key not in meta.features:
            raise UserError(f"{meta.root}: the dataset has no feature `{key}`; it has {', '.join(meta.features)}")


def _present_episodes(meta: "LeRobotDatasetMetadata") -> Array:
    """(episodes,) whether the file that holds an episode's numbers is there."""
    places = np.stack([_of_episodes(meta, f"data/{part}_index") for part in ("chunk", "file")], axis=1)
    files, which = np.unique(places, axis=0, return_inverse=True)
    there = [
        (Path(meta.root) / meta.data_path.format(chunk_index=c, file_index=f)).is_file() for c, f in files.tolist()
    ]
    if not any(there):
        raise UserError(f"{meta.root}: none of the dataset's {len(there)} data files is there: fetch it again")
    return np.array(there)[which.reshape(-1)]


def _fits_memory(meta: "LeRobotDatasetMetadata", keys: Sequence[str]) -> bool:
    size = sum(meta.total_frames * math.prod(meta.features[key]["shape"]) * _dtype(meta, key).itemsize for key in keys)
    free = psutil.virtual_memory().available
    if size <= _SHARE_OF_MEMORY * free:
        return True
    logging.info("%s: %.1f GB of frames are memory-mapped, %.1f GB are free", meta.root, size / 1e9, free / 1e9)
    return False


def _dtype(meta: "LeRobotDatasetMetadata", key: str) -> np.dtype:
    name = meta.features[key]["dtype"]
    return np.dtype("uint8" if name in ("image", "video") else name)


def _read(
    meta: "LeRobotDatasetMetadata", keys: Sequence[str], allocate: Allocate, present: Array, missing: int
) -> dict[str, Array]:
    pictures = [key for key in keys if meta.features[key]["dtype"] in ("image", "video")]
    numbers = [key for key in keys if key not in pictures]
    columns = _read_numbers(meta, numbers, allocate, missing)
    return {**columns, **_read_pictures(meta, pictures, allocate, present)}


def _read_numbers(
    meta: "LeRobotDatasetMetadata", keys: Sequence[str], allocate: Allocate, missing: int
) -> dict[str, Array]:
    """Columns of all frames; those of `missing` ones, whose files are not there, stay as they were allocated."""
    frames = meta.total_frames
    columns = {key: allocate(key, (frames, *meta.features[key]["shape"]), _dtype(meta, key)) for key in keys}
    seen = 0
    for table in _tables(Path(meta.root), [*keys, "index"]):
        index = table.column("index").to_numpy()
        if len(index) and (index.min() < 0 or index.max() >= frames):
            raise UserError(
                f"{meta.root}: data files hold frame {index.max()}, but meta/info.json counts {frames} frames"
            )
        for key, column in columns.items():
            column[index] = _values(table.column(key)).reshape(len(index), *column.shape[1:])
        seen += len(index)
    if seen + missing != frames:
        raise UserError(
            f"{meta.root}: data files hold {seen} frames, but {frames - missing} belong there: fetch it again"
        )
    return columns


def _tables(root: Path, names: Sequence[str]) -> Iterator[pa.Table]:
    """Row groups, so that memory stays at one of them."""
    for path in sorted((root / "data").rglob("*.parquet")):
        with pq.ParquetFile(path) as file:
            for batch in file.iter_batches(batch_size=65_536, columns=list(names)):
                yield pa.Table.from_batches([batch])


def _values(column: pa.ChunkedArray) -> Array:
    """Numbers of a column of scalars or (nested) lists, flat."""
    array = column.combine_chunks()
    if isinstance(array, pa.ExtensionArray):
        array = array.storage
    while pa.types.is_list(array.type) or pa.types.is_fixed_size_list(array.type) or pa.types.is_large_list(array.type):
        array = array.flatten()
    return array.to_numpy(zero_copy_only=False)


def _read_pictures(
    meta: "LeRobotDatasetMetadata", keys: Sequence[str], allocate: Allocate, present: Array
) -> dict[str, Array]:
    """Decode pictures of the episodes that are there once, to uint8 with channels first."""
    if not keys:
        return {}
    from lerobot.datasets.lerobot_dataset import LeRobotDataset  # slow to import, needed for pictures only

    episodes = None if present.all() else np.flatnonzero(present).tolist()
    dataset = LeRobotDataset(meta.repo_id, root=meta.root, episodes=episodes, return_uint8=True)
    columns: dict[str, Array] = {}
    for frame in _progress((dataset[i] for i in range(len(dataset))), len(dataset)):
        for key in keys:
            if key not in columns:
                columns[key] = allocate(key, (meta.total_frames, *frame[key].shape), _dtype(meta, key))
            columns[key][int(frame["index"])] = _bytes(frame[key])
    return columns


def _bytes(picture: torch.Tensor) -> Array:
    scaled = picture if picture.dtype == torch.uint8 else (picture * 255).round().to(torch.uint8)
    return scaled.numpy()


def _progress(frames: Iterable[dict[str, torch.Tensor]], total: int) -> Iterable[dict[str, torch.Tensor]]:
    return tqdm(frames, total=total, desc="Decoding pictures", unit="frame", disable=None)
