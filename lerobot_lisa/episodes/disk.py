"""Columns of an episode store as memory-mapped files: shared between processes, and larger than memory if need be."""

import hashlib
import json
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from filelock import FileLock, Timeout
from lerobot.utils.constants import HF_LEROBOT_HOME
from numpy.typing import NDArray

Array = NDArray[Any]
Allocate = Callable[[str, tuple[int, ...], np.dtype[Any]], Array]

_SOURCE = "source.json"  # which dataset and features a folder was made from
_LOCK = "lock"


def mapped_columns(root: Path, keys: Sequence[str], read: Callable[[Allocate], object]) -> dict[str, Array]:
    """Columns from memory-mapped files, which are made once for each state of a dataset's files.

    Files of earlier states of any dataset, and what killed processes have left, are removed when new ones are made.

    Args:
        root: Folder of the dataset.
        keys: Features.
        read: Fills arrays that it asks its argument for, one per feature.
    """
    home = HF_LEROBOT_HOME / "lisa_episode_store"
    folder = home / _fingerprint(root, keys)
    if not folder.exists():
        _make(folder, root, keys, read)
        _clean(home)
    # Copy-on-write: torch wants a writable array, and nothing must ever reach the files.
    return {key: np.load(folder / f"{key}.npy", mmap_mode="c") for key in keys}


def _make(folder: Path, root: Path, keys: Sequence[str], read: Callable[[Allocate], object]) -> None:
    """Build aside and rename; processes that train together may do so at the same time, and the first one wins."""
    with _partial(folder) as partial:
        read(
            lambda key, shape, dtype: np.lib.format.open_memmap(
                partial / f"{key}.npy", mode="w+", dtype=dtype, shape=shape
            )
        )
        (partial / _SOURCE).write_text(json.dumps({"root": str(Path(root).absolute()), "keys": sorted(keys)}))
        try:
            partial.rename(folder)
        except OSError:
            if not folder.exists():
                raise


@contextmanager
def _partial(folder: Path) -> Iterator[Path]:
    """A folder to build in, locked for as long as this process lives, and removed if it is still there at the end."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    partial = Path(tempfile.mkdtemp(prefix=f"{folder.name}.", suffix=".partial", dir=folder.parent))
    try:
        with FileLock(f"{partial}.{_LOCK}"):
            yield partial
    finally:
        shutil.rmtree(partial, ignore_errors=True)
        Path(f"{partial}.{_LOCK}").unlink(missing_ok=True)


def _clean(home: Path) -> None:
    """Remove what no dataset on this machine can use any more; whoever has it mapped keeps it until they end."""
    for folder in home.iterdir():
        if folder.is_dir() and (_abandoned(folder) if folder.suffix == ".partial" else _outdated(folder)):
            shutil.rmtree(folder, ignore_errors=True)


def _abandoned(partial: Path) -> bool:
    """Whether nobody builds here any more."""
    lock = Path(f"{partial}.{_LOCK}")
    try:
        with FileLock(lock, timeout=0):
            lock.unlink(missing_ok=True)
            return True
    except Timeout:
        return False


def _outdated(folder: Path) -> bool:
    """Whether the dataset has gone or changed; folders that do not say where they come from are left alone."""
    try:
        source = json.loads((folder / _SOURCE).read_text())
        return _fingerprint(Path(source["root"]), source["keys"]) != folder.name
    except (OSError, ValueError, KeyError):
        return False


def _fingerprint(root: Path, keys: Sequence[str]) -> str:
    """Changes whenever the dataset's place, files or the features asked for change."""
    files = sorted(path for path in Path(root).absolute().rglob("*") if path.is_file())
    state = [(str(path), path.stat().st_size, path.stat().st_mtime_ns) for path in files]
    return hashlib.sha256(repr((sorted(keys), state)).encode()).hexdigest()[:32]
