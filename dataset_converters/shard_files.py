"""Shard files: named arrays for a range of seeds, on disk as a whole or not at all."""

import zipfile
from pathlib import Path

import numpy as np

from dataset_converters.seeds import SeedRange


def shard_path(folder: Path, seeds: SeedRange, kind: str = "seeds") -> Path:
    """Where the shard of a range of seeds lies."""
    return folder / f"{kind}-{seeds.first:012d}-{seeds.stop:012d}.npz"


def is_complete(path: Path) -> bool:
    """Whether there is a shard at `path`."""
    return path.is_file() and zipfile.is_zipfile(path)


def save_arrays(path: Path, **arrays: np.ndarray) -> None:
    """Write a shard at once or not at all, so that an interruption leaves only whole shards."""
    unfinished = path.with_suffix(".tmp")
    with unfinished.open("wb") as file:
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]
    unfinished.replace(path)


def load_arrays(path: Path) -> dict[str, np.ndarray]:
    """All arrays of a shard."""
    with np.load(path, allow_pickle=False) as shard:
        return {name: shard[name] for name in shard.files}
