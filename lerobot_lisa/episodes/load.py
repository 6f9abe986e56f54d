"""Fill an episode store from a LeRobotDataset: numbers straight from parquet, pictures through LeRobot's decoder."""

import hashlib
import shutil
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import torch
from lerobot.utils.constants import HF_LEROBOT_HOME
from numpy.typing import NDArray
from tqdm import tqdm

from lerobot_lisa.episodes.store import EpisodeStore
from lerobot_lisa.errors import UserError

if TYPE_CHECKING:
    from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata

Array = NDArray[Any]
Allocate = Callable[[str, tuple[int, ...], np.dtype[Any]], Array]


def load_episodes(meta: "LeRobotDatasetMetadata", keys: Sequence[str], location: str = "memory") -> EpisodeStore:
    """Read features of every frame of a dataset.

    Args:
        meta: The dataset, complete on disk under `meta.root`.
        keys: Features to read.
        location: "memory", or "disk" for files that are mapped into memory and shared between processes.

    Raises:
        UserError: The files do not hold the frames that the metadata promises.
    """
    starts, stops = meta.episodes["dataset_from_index"], meta.episodes["dataset_to_index"]
    lengths = [stop - start for start, stop in zip(starts, stops, strict=True)]
    columns = _mapped(meta, keys) if location == "disk" else _read(meta, keys, lambda _, s, t: np.empty(s, t))
    return EpisodeStore({key: torch.from_numpy(column) for key, column in columns.items()}, list(starts), lengths)


def _mapped(meta: "LeRobotDatasetMetadata", keys: Sequence[str]) -> dict[str, Array]:
    """Columns as memory-mapped files, made once for each state of the dataset's files."""
    folder = HF_LEROBOT_HOME / "lisa_episode_store" / _fingerprint(meta, keys)
    if not folder.exists():
        _make_files(meta, keys, folder)
    # Copy-on-write: torch wants a writable array, and nothing must ever reach the files.
    return {key: np.load(folder / f"{key}.npy", mmap_mode="c") for key in keys}


def _make_files(meta: "LeRobotDatasetMetadata", keys: Sequence[str], folder: Path) -> None:
    """Build aside and rename; processes that train together may do so at the same time, and the first one wins."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    partial = Path(tempfile.mkdtemp(prefix=f"{folder.name}.", suffix=".partial", dir=folder.parent))

    def allocate(key: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> Array:
        return np.lib.format.open_memmap(partial / f"{key}.npy", mode="w+", dtype=dtype, shape=shape)

    try:
        _read(meta, keys, allocate)
        partial.rename(folder)
    except OSError:
        if not folder.exists():
            raise
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def _fingerprint(meta: "LeRobotDatasetMetadata", keys: Sequence[str]) -> str:
    """Changes whenever the dataset's place, files or the features asked for change."""
    files = sorted(path for path in Path(meta.root).rglob("*") if path.is_file())
    state = [(str(path), path.stat().st_size, path.stat().st_mtime_ns) for path in files]
    return hashlib.sha256(repr((sorted(keys), state)).encode()).hexdigest()[:32]


def _read(meta: "LeRobotDatasetMetadata", keys: Sequence[str], allocate: Allocate) -> dict[str, Array]:
    pictures = [key for key in keys if meta.features[key]["dtype"] in ("image", "video")]
    numbers = [key for key in keys if key not in pictures]
    return {**_read_numbers(meta, numbers, allocate), **_read_pictures(meta, pictures, allocate)}


def _read_numbers(meta: "LeRobotDatasetMetadata", keys: Sequence[str], allocate: Allocate) -> dict[str, Array]:
    frames = meta.total_frames
    columns = {
        key: allocate(key, (frames, *meta.features[key]["shape"]), np.dtype(meta.features[key]["dtype"]))
        for key in keys
    }
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
    if seen != frames:
        raise UserError(
            f"{meta.root}: data files hold {seen} frames, but meta/info.json counts {frames}: fetch it again"
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


def _read_pictures(meta: "LeRobotDatasetMetadata", keys: Sequence[str], allocate: Allocate) -> dict[str, Array]:
    """Decode pictures once, to uint8 with channels first."""
    if not keys:
        return {}
    from lerobot.datasets.lerobot_dataset import LeRobotDataset  # slow to import, needed for pictures only

    dataset = LeRobotDataset(meta.repo_id, root=meta.root, return_uint8=True)
    columns: dict[str, Array] = {}
    for index in _progress(range(meta.total_frames)):
        frame = dataset[index]
        for key in keys:
            if key not in columns:
                columns[key] = allocate(key, (meta.total_frames, *frame[key].shape), np.dtype("uint8"))
            columns[key][index] = _bytes(frame[key])
    return columns


def _bytes(picture: torch.Tensor) -> Array:
    scaled = picture if picture.dtype == torch.uint8 else (picture * 255).round().to(torch.uint8)
    return scaled.numpy()


def _progress(frames: Iterable[int]) -> Iterable[int]:
    return tqdm(frames, desc="Decoding pictures", unit="frame", disable=None)
