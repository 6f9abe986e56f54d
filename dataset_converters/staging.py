"""Builds a dataset aside in `<root>.partial` and moves it into place in one rename; one process at a time."""

import errno
import hashlib
import json
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import FileLock, Timeout

from lerobot_lisa.errors import UserError

_SETTINGS, _UNFINISHED_SETTINGS, _LOCK = "settings.json", "settings.tmp", "lock"


@contextmanager
def staged(root: Path, settings: Mapping[str, object]) -> Iterator[Path]:
    """Give a private directory for building `root`; a clean exit moves its `dataset/` to `root`.

    What lies in its `shards/` survives a failure or an interruption and is found again by the next run with the same
    settings. Everything else is removed on failure. Whenever this process is killed, the same run can be made again:
    nothing is left beside `root` once it is there, and what is left before that is told by its settings.

    Args:
        root: final directory; it must not exist.
        settings: JSON values that must be the same for a run to resume this one.

    Yields:
        The existing directory `<root>.partial`.

    Raises:
        UserError: if `root` exists, cannot be written, is being written by another process, or if an unfinished run
            with other settings lies there.
    """
    refuse_existing(root)
    partial = root.with_name(root.name + ".partial")
    complete = root.with_name(f"{root.name}.complete-{hashlib.sha256(_described(settings).encode()).hexdigest()[:16]}")
    with one_line_for_disk_errors(root):
        note_settings(partial, settings)
        try:
            with _only_process(root, partial / _LOCK):
                refuse_existing(root)
                _remove(partial / "dataset")
                _remove(complete)  # its name says that a run with these settings was killed just before its end
                try:
                    yield partial
                    refuse_existing(root)
                    (partial / "dataset").rename(complete)
                    clear(partial)
                except BaseException:
                    _remove(complete)
                    _remove(partial / "dataset")
                    if not _has_shards(partial):
                        clear(partial)
                    raise
        finally:
            with suppress(OSError):  # it is not empty, or there is nothing
                partial.rmdir()  # not under the lock: network file systems keep a file that is open
        complete.rename(root)


def refuse_existing(root: Path) -> None:
    """Raise `UserError` if there is something at `root`: datasets are never overwritten."""
    with one_line_for_disk_errors(root):
        if root.exists() or root.is_symlink():
            raise UserError(f"{root} exists and is left untouched; choose another --root or delete it yourself")


def note_settings(folder: Path, settings: Mapping[str, object]) -> None:
    """Create `folder` with a note of a run's settings, or check the note of the run that has left it.

    Raises:
        UserError: it holds an unfinished run with other settings, or something that is not ours.
    """
    note, unfinished = folder / _SETTINGS, folder / _UNFINISHED_SETTINGS
    if folder.exists() and not folder.is_dir():
        raise UserError(f"{folder} is in the way and was not made by this program; move it or choose another --root")
    folder.mkdir(parents=True, exist_ok=True)
    if note.is_file():
        if note.read_text() != _described(settings):
            raise UserError(f"{folder} holds an unfinished run with other settings; delete it or choose another --root")
    elif {path.name for path in folder.iterdir()} <= {_UNFINISHED_SETTINGS, _LOCK}:
        unfinished.write_text(_described(settings))
        unfinished.replace(note)
    else:
        raise UserError(f"{folder} is in the way and was not made by this program; move it or choose another --root")


def clear(folder: Path, but: Path | None = None) -> None:
    """Empty a folder of a run: its settings last but for the lock, so that a run that is killed here can be made again.

    Args:
        folder: where `note_settings` was called.
        but: what stays.
    """
    last = [folder / name for name in (_SETTINGS, _LOCK)]
    for path in [*(path for path in folder.iterdir() if path not in [*last, but]), *last]:
        _remove(path)


@contextmanager
def one_line_for_disk_errors(root: Path) -> Iterator[None]:
    """Turn an `OSError` while `root` is written into a `UserError` that says what to do."""
    try:
        yield
    except OSError as error:
        fix = "free some space" if error.errno == errno.ENOSPC else "choose a --root that you can write to"
        raise UserError(f"{root}: {error.strerror or error}; {fix} and run the same command again") from error


def _described(settings: Mapping[str, object]) -> str:
    return json.dumps(dict(settings), indent=2, sort_keys=True)


@contextmanager
def _only_process(root: Path, lock: Path) -> Iterator[None]:
    try:
        with FileLock(lock, timeout=0):
            yield
    except Timeout:
        message = f"{root}: another process is writing this dataset; wait for it or choose another --root"
        raise UserError(message) from None


def _has_shards(partial: Path) -> bool:
    shards = partial / "shards"
    return shards.is_dir() and any(shards.iterdir())


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with suppress(OSError):
            path.unlink()
