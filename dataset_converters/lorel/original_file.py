"""The original HDF5 file, opened so that it is checked before it is believed: nothing outside it is ever read."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import h5py
import numpy as np

from dataset_converters.lorel.episode import IMAGE_SHAPE
from lerobot_lisa.envs.lorel.state import ACTION_NAMES, STATE_NAMES
from lerobot_lisa.errors import UserError

GROUP = "sim"
SHAPES = {"state": (len(STATE_NAMES),), "actions": (len(ACTION_NAMES),), "ims": IMAGE_SHAPE}
"""Shape of one frame of each array; arrays are (episodes, frames, *shape) float32."""

QUALITY = "image_quality"
"""Attribute of the group in which our collection says how it rendered; the original file has none."""

_LARGEST_CHUNK = 2**28  # bytes: HDF5 holds whole chunks of a chunked array in memory
_EPISODES_PER_READ = 16  # 16 MB of images
_MOST_FRAMES = 1000  # of an episode; the original has 20


class Block(NamedTuple):
    """Consecutive episodes of the file."""

    first: int
    state: np.ndarray  # (n, T, 15) float32
    action: np.ndarray  # (n, T, 5) float32
    images: np.ndarray | None  # (n, T, 64, 64, 3) uint8


class OriginalFile:
    """An open file with checked links, ranks and dtypes; values are checked as they are read."""

    def __init__(self, path: Path, file: h5py.File, images: bool) -> None:
        self._path = path
        group = _hard_link(path, file, GROUP, h5py.Group)
        names = [name for name in SHAPES if images or name != "ims"]
        self._arrays = {name: _array(path, group, name) for name in names}
        self.episodes, self.frames = self._arrays["state"].shape[:2]
        for name, array in self._arrays.items():
            episodes, frames = array.shape[:2]
            if (episodes, frames) != (self.episodes, self.frames):
                raise UserError(
                    f"{path}: {GROUP}/{name} has {episodes} episodes of {frames} frames, {GROUP}/state has "
                    f"{self.episodes} of {self.frames}; is the file half written?"
                )
        self.image_quality = _quality(path, group) if images else None

    def blocks(self, count: int) -> Iterator[Block]:
        """The first `count` episodes, a few at a time.

        Raises:
            UserError: naming the first episode with a value that is missing or out of range.
        """
        for first in range(0, count, _EPISODES_PER_READ):
            part = slice(first, min(first + _EPISODES_PER_READ, count))
            values = {name: self._read(name, part) for name in self._arrays}
            images = _to_uint8(values["ims"]) if "ims" in values else None
            yield Block(first, values["state"], values["actions"], images)

    def _read(self, name: str, part: slice) -> np.ndarray:
        try:
            values: np.ndarray = self._arrays[name][part]
        except (OSError, RuntimeError, ValueError) as error:
            raise UserError(f"{self._path}: {GROUP}/{name} cannot be read ({_reason(error)}); copy it again") from error
        self._refuse(name, part, ~np.isfinite(values), "holds a value that is NaN or infinite; leave it out")
        if name == "ims":
            self._refuse(name, part, (values < 0) | (values > 1), "has a pixel outside [0, 1]; scale the images")
        # no real episode is all zeros, and what was never written reads as zeros
        empty = np.all(values.reshape(len(values), -1) == 0, axis=1)
        self._refuse(name, part, empty, "is all zeros; the file is only half written")
        return values

    def _refuse(self, name: str, part: slice, bad: np.ndarray, problem: str) -> None:
        found = np.flatnonzero(bad.reshape(len(bad), -1).any(axis=1))
        if len(found):
            raise UserError(f"{self._path}: {GROUP}/{name} of episode {part.start + found[0]} {problem}")


@contextmanager
def open_original(path: Path, images: bool) -> Iterator[OriginalFile]:
    """Open an original file for reading.

    Args:
        path: of the HDF5 file.
        images: whether its images will be read.

    Raises:
        UserError: if it is not a whole HDF5 file; if a group or an array is missing, lies elsewhere, or has another
            rank or dtype.
    """
    try:
        file = h5py.File(path, "r")
    except FileNotFoundError as error:
        raise UserError(f"{path} does not exist; give the HDF5 file of the original data set") from error
    except (OSError, RuntimeError) as error:
        raise UserError(f"{path}: cannot be read as HDF5 ({_reason(error)}); is it whole?") from error
    with file:
        yield OriginalFile(path, file, images)


def _hard_link[Kind](path: Path, parent: h5py.Group, name: str, kind: type[Kind]) -> Kind:
    """The member `name`, which must be of `kind` and lie in this very file."""
    where = f"{parent.name.rstrip('/')}/{name}".lstrip("/")
    try:
        link = parent.get(name, getlink=True)
        if link is None:
            raise UserError(
                f"{path}: has no {where}; it needs {GROUP}/state, {GROUP}/actions and, for images, {GROUP}/ims"
            )
        if not isinstance(link, h5py.HardLink):
            raise UserError(
                f"{path}: {where} is a link to somewhere else, which is refused; store it in the file itself"
            )
        found = parent[name]
    except (OSError, RuntimeError, KeyError) as error:
        raise UserError(f"{path}: {where} cannot be read ({_reason(error)}); is the file whole?") from error
    if not isinstance(found, kind):
        raise UserError(f"{path}: {where} is a {type(found).__name__}, not a {kind.__name__}")
    return found


def _array(path: Path, group: h5py.Group, name: str) -> h5py.Dataset:
    array = _hard_link(path, group, name, h5py.Dataset)
    where, shape = f"{path}: {GROUP}/{name}", SHAPES[name]
    if array.dtype != np.float32 or array.shape is None or array.shape[2:] != shape or array.ndim != 2 + len(shape):
        expected = f"float32 (episodes, frames, {', '.join(map(str, shape))})"
        raise UserError(f"{where} is {array.dtype} {array.shape}, expected {expected}")
    if 0 in array.shape or array.shape[1] > _MOST_FRAMES:
        raise UserError(f"{where} has shape {array.shape}: it needs episodes of 1 to {_MOST_FRAMES} frames")
    if array.is_virtual or array.external:
        raise UserError(f"{where} keeps its values in another file, which is refused; store them in the file itself")
    if math.prod(array.chunks or ()) * array.dtype.itemsize > _LARGEST_CHUNK:
        raise UserError(f"{where} has chunks of more than {_LARGEST_CHUNK >> 20} MiB; repack it with smaller ones")
    if array.chunks is None and array.id.get_storage_size() < array.nbytes:
        raise UserError(f"{where} was created but never written; the file is only half written")
    return array


def _quality(path: Path, group: h5py.Group) -> str:
    """How the images were rendered: the original renderer had everything on."""
    try:
        quality = group.attrs.get(QUALITY, "full")
    except (OSError, RuntimeError, TypeError) as error:
        raise UserError(f"{path}: the attribute {QUALITY} cannot be read ({_reason(error)})") from error
    if not isinstance(quality, str) or not quality.isidentifier():
        raise UserError(f"{path}: the attribute {QUALITY} is {quality!r}, not the name of an image quality")
    return quality


def _to_uint8(images: np.ndarray) -> np.ndarray:
    return np.rint(images * np.float32(255)).astype(np.uint8)


def _reason(error: BaseException) -> str:
    return " ".join(str(error).split())
