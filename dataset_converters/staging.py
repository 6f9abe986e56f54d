"""Builds a dataset aside in `<root>.partial` and moves it into place in one rename; one process at a time."""

import errno
import json
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

from lerobot_lisa.errors import UserError

_SETTINGS = "settings.json"


@contextmanager
def staged(root: Path, settings: Mapping[str, object]) -> Iterator[Path]:
    """Give a private directory for building `root`; a clean exit moves its `dataset/` to `root`.

    What lies in its `shards/` survives a failure or an interruption and is found again by the next run with the same
    settings. Everything else is removed on failure.

    Args:
        root: final directory; it must not exist.
        settings: JSON values that must be the same for a run to resume this one.

    Yields:
        The existing directory `<root>.partial`.

    Raises:
        UserError: if `root` exists, cannot be written, is being written by another process, or if an unfinished run
            with other settings lies there.
    """
    partial = root.with_name(root.name + ".partial")
    refuse_existing(root)
    with _one_line_for_disk_errors(root):
        _open_partial(partial, settings)
        lock = FileLock(partial / "lock")
        try:
            lock.acquire(timeout=0)
        except Timeout:
            message = f"{root}: another process is writing this dataset; wait for it or choose another --root"
            raise UserError(message) from None
        try:
            refuse_existing(root)
            _remove(partial / "dataset")
            yield partial
            (partial / "dataset").rename(root)
            lock.release()
            _remove(partial)
        except BaseException:
            lock.release()
            _remove_all_but_shards(partial)
            raise


def refuse_existing(root: Path) -> None:
    """Raise `UserError` if there is something at `root`: datasets are never overwritten."""
    if root.exists() or root.is_symlink():
        raise UserError(f"{root} exists and is left untouched; choose another --root or delete it yourself")


def _open_partial(partial: Path, settings: Mapping[str, object]) -> None:
    """Create the directory, or check that the one found there was left by a run with these settings."""
    described = json.dumps(dict(settings), indent=2, sort_keys=True)
    note = partial / _SETTINGS
    if not partial.exists():
        partial.mkdir(parents=True)
        note.write_text(described)
    elif not note.is_file():
        raise UserError(f"{partial} is in the way and was not made by this program; move it or choose another --root")
    elif note.read_text() != described:
        raise UserError(f"{partial} holds an unfinished run with other settings; delete it or choose another --root")


@contextmanager
def _one_line_for_disk_errors(root: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        fix = "free some space" if error.errno == errno.ENOSPC else "choose a --root that you can write to"
        raise UserError(f"{root}: {error.strerror or error}; {fix} and run the same command again") from error


def _remove_all_but_shards(partial: Path) -> None:
    shards = partial / "shards"
    if shards.is_dir() and any(shards.iterdir()):
        _remove(partial / "dataset")
    else:
        _remove(partial)


def _remove(path: Path) -> None:
    shutil.rmtree(path, ignore_errors=True)
