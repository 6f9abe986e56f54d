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

from lerobot_lisa.episodes.check import FrameLedger, bounds, check_columns, check_metadata
from lerobot_lisa.episodes.disk import Allocate, Array, clear_abandoned, mapped_columns
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
    clear_abandoned()
    starts, stops = check_metadata(meta, keys)
    ledger = FrameLedger(meta.root, starts, stops, present := _present_episodes(meta))
    if location == "disk" or not _fits_memory(meta, keys):
        columns = mapped_columns(Path(meta.root), keys, lambda allocate: _read(meta, keys, allocate, ledger))
    else:
        columns = _read(meta, keys, lambda _, shape, dtype: np.empty(shape, dtype), ledger)
    tensors = {key: torch.from_numpy(column) for key, column in columns.items()}
    return EpisodeStore(tensors, starts, stops - starts, present)


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
    name = meta.features[key]["dtype"]
    return np.dtype("uint8" if name in ("image", "video") else name)


def _read(
    meta: "LeRobotDatasetMetadata", keys: Sequence[str], allocate: Allocate, ledger: FrameLedger
) -> dict[str, Array]:
    pictures = [key for key in keys if meta.features[key]["dtype"] in ("image", "video")]
    numbers = [key for key in keys if key not in pictures]
    columns = _read_numbers(meta, numbers, allocate, ledger)
    return {**columns, **_read_pictures(meta, pictures, allocate, ledger.present)}


def _read_numbers(
    meta: "LeRobotDatasetMetadata", keys: Sequence[str], allocate: Allocate, ledger: FrameLedger
) -> dict[str, Array]:
    """Columns of all frames; those of episodes that are not present stay as they were allocated."""
    shapes = {key: (meta.total_frames, *meta.features[key]["shape"]) for key in keys}
    columns = {key: allocate(key, shape, _dtype(meta, key)) for key, shape in shapes.items()}
    allowed = {key: bounds(meta, key) for key in keys}
    for path, table in _tables(Path(meta.root), [*keys, "index", "episode_index"]):
        frames = _values(path, table, "index")
        rows = ledger.note(frames, _values(path, table, "episode_index"))
        for key, column in columns.items():
            values = _values(path, table, key, column.shape[1:])
            ledger.check_values(key, values, frames, allowed[key])
            column[rows] = values
    ledger.check_complete()
    return columns


def _tables(root: Path, names: Sequence[str]) -> Iterator[tuple[Path, pa.Table]]:
    """Row groups and the files they are from, so that memory stays at one of them."""
    for path in sorted((root / "data").rglob("*.parquet")):
        check_columns(path, names)
        with pq.ParquetFile(path) as file:
            for batch in file.iter_batches(batch_size=65_536, columns=list(names)):
                yield path, pa.Table.from_batches([batch])


def _values(path: Path, table: pa.Table, key: str, shape: tuple[int, ...] = ()) -> Array:
    """Numbers of a column of scalars or (nested) lists, (rows, *shape)."""
    array = table.column(key).combine_chunks()
    if isinstance(array, pa.ExtensionArray):
        array = array.storage
    while pa.types.is_list(array.type) or pa.types.is_fixed_size_list(array.type) or pa.types.is_large_list(array.type):
        array = array.flatten()
    if array.null_count or len(array) != table.num_rows * math.prod(shape):
        raise UserError(
            f"{path}: `{key}` does not hold {math.prod(shape)} numbers in each row: fetch the dataset again"
        )
    return array.to_numpy(zero_copy_only=False).reshape(table.num_rows, *shape)


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
