"""Columns of an episode store as memory-mapped files: shared between processes, and larger than memory if need be."""

import errno
import hashlib
import json
import os
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any
from uuid import uuid4

import numpy as np
from filelock import FileLock, Timeout
from lerobot.utils.constants import HF_LEROBOT_HOME
from numpy.typing import NDArray

from lerobot_lisa.errors import UserError

Array = NDArray[Any]
Allocate = Callable[[str, tuple[int, ...], np.dtype[Any]], Array]

_SOURCE = "source.json"  # which dataset and features a folder was made from
_LOCK = "lock"


def mapped_columns(root: Path, keys: Sequence[str], read: Callable[[Allocate], object]) -> dict[str, Array]:
    """Columns from memory-mapped files, which are made once for each state of a dataset's files.

    Args:
        root: Folder of the dataset.
        keys: Features.
        read: Fills arrays that it asks its argument for, one per feature.

    Raises:
        UserError: The files cannot be written.
    """
    folder = kept_folder(root, keys, lambda partial: read(partial_allocate(partial)))
    # Copy-on-write: torch wants a writable array, and nothing must ever reach the files.
    return {key: np.load(folder / f"{key}.npy", mmap_mode="c") for key in keys}


def kept_folder(root: Path, what: Sequence[str], make: Callable[[Path], object]) -> Path:
    """A folder of files that are made once for each state of a dataset's files.

    Folders of earlier states of any dataset are removed when a new one is made.

    Args:
        root: Folder of the dataset.
        what: Names of what the files hold; other names have another folder.
        make: Fills a folder.

    Raises:
        UserError: The folder cannot be written.
    """
    folder = store_home() / _fingerprint(root, what)
    if not folder.exists():
        _make(folder, root, what, make)
        _clear_outdated()
    return folder


def store_home() -> Path:
    """Where episode stores are kept."""
    return HF_LEROBOT_HOME / "lisa_episode_store"


def clear_abandoned() -> None:
    """Remove what killed processes have left."""
    for lock in store_home().glob(f"*.partial.{_LOCK}"):
        with suppress(OSError, Timeout), FileLock(lock, timeout=0):
            shutil.rmtree(lock.with_suffix(""), ignore_errors=True)
            lock.unlink()


@contextmanager
def told_in_one_line(what: str) -> Iterator[None]:
    """Turn what a file system says, on a full or write-protected disk, into a `UserError`."""
    try:
        yield
    except OSError as error:
        home, reason = store_home(), error.strerror or str(error)
        raise UserError(f"{home}: cannot keep {what} there ({reason}): make room, or set HF_LEROBOT_HOME") from error


def _make(folder: Path, root: Path, what: Sequence[str], make: Callable[[Path], object]) -> None:
    """Build aside and rename; processes that train together may do so at the same time, and the first one wins."""
    with _partial(folder) as partial:
        make(partial)
        with told_in_one_line("the episode store"):
            (partial / _SOURCE).write_text(json.dumps({"root": str(Path(root).absolute()), "keys": sorted(what)}))
            try:
                partial.rename(folder)
            except OSError:
                if not folder.exists():
                    raise


def partial_allocate(folder: Path) -> Allocate:
    """Makes arrays in files of a folder, with room on the disk for all of them."""

    def allocate(key: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> Array:
        array = sparse_array(folder / f"{key}.npy", shape, dtype)
        take_room(folder / f"{key}.npy", array, 0, len(array))
        return array

    return allocate


def sparse_array(path: Path, shape: tuple[int, ...], dtype: np.dtype[Any]) -> Array:
    """A new array of zeros in a memory-mapped file, which takes no room on the disk yet."""
    with told_in_one_line("the episode store"):
        return np.lib.format.open_memmap(path, mode="w+", dtype=dtype, shape=shape)


def take_room(path: Path, array: Array, start: int, stop: int) -> None:
    """Take the room on the disk that rows of an array in a memory-mapped file need.

    Without that, a disk that fills up later ends the process at some write to memory (SIGBUS), without a word.

    Raises:
        UserError: There is not enough.
    """
    row = array.nbytes // max(len(array), 1)
    with told_in_one_line(f"{row * (stop - start) / 1e9:.1f} GB of the episode store"):
        if row * (stop - start) > shutil.disk_usage(path.parent).free:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        if stop > start and hasattr(os, "posix_fallocate"):  # not on macOS
            with path.open("r+b") as file:
                _allocate(file.fileno(), path.stat().st_size - array.nbytes + row * start, row * (stop - start))


def _allocate(descriptor: int, offset: int, size: int) -> None:
    try:
        os.posix_fallocate(descriptor, offset, size)
    except OSError as error:
        if error.errno not in (errno.EOPNOTSUPP, errno.EINVAL):  # a file system that cannot
            raise


@contextmanager
def _partial(folder: Path) -> Iterator[Path]:
    """A folder to build in, locked for as long as this process lives, and removed if it is still there at the end."""
    partial = folder.with_name(f"{folder.name}.{uuid4().hex[:8]}.partial")
    lock = FileLock(f"{partial}.{_LOCK}")
    with told_in_one_line("the episode store"):
        folder.parent.mkdir(parents=True, exist_ok=True)
        lock.acquire()
        partial.mkdir()
    try:
        yield partial
    finally:
        shutil.rmtree(partial, ignore_errors=True)
        Path(lock.lock_file).unlink(missing_ok=True)
        lock.release()


def _clear_outdated() -> None:
    """Remove what no dataset on this machine can use any more; whoever has it mapped keeps it until they end."""
    for folder in store_home().iterdir():
        if folder.is_dir() and _outdated(folder):
            shutil.rmtree(folder, ignore_errors=True)


def _outdated(folder: Path) -> bool:
    """Whether the dataset has gone or changed; folders that do not say where they come from are left alone."""
    try:
        source = json.loads((folder / _SOURCE).read_text())
        return _fingerprint(Path(source["root"]), source["keys"]) != folder.name
    except (OSError, ValueError, KeyError):
        return False


def _fingerprint(root: Path, keys: Sequence[str]) -> str:
    """Changes whenever the dataset's place, files or the features asked for change."""
    root = Path(root).absolute()
    files = sorted(path for path in root.rglob("*") if path.is_file() and not _hidden(path.relative_to(root)))
    state = [(str(path), path.stat().st_size, path.stat().st_mtime_ns) for path in files]
    return hashlib.sha256(repr((sorted(keys), state)).encode()).hexdigest()[:32]


def _hidden(path: Path) -> bool:
    """Whether this is what the Hub's client notes for itself, at every start."""
    return any(part.startswith(".") for part in path.parts)
