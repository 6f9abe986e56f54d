"""Reads the original BabyAI demonstration files, without running anything that they hold.

A file is a pickled list of `(instruction, packed images, directions, actions)`; the images of an episode are a second
pickle inside a blosc buffer (babyai/utils/demos.py of the BabyAI package). See `pickle_reader` for the safety.
"""

import mmap
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import chain, islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from dataset_converters.babyai.demonstration import GRID_SHAPE, GRID_SIZE, Demonstration
from dataset_converters.babyai.encodings import CellEncoding, detect, to_minigrid
from dataset_converters.babyai.pickle_parts import ARRAY_PARTS, DEMO_PARTS, as_bytes
from dataset_converters.babyai.pickle_reader import PickleRefusedError, read_items, read_value
from lerobot_lisa.errors import UserError

_DETECT_FROM = 1000  # demonstrations that are looked at to find the cell encoding
_BLOSC_HEADER = 16  # bytes
_FILE_NAME = re.compile(r"BabyAI-(?P<level>\w+?)-v\d+(?:_valid)?\.pkl")


class RawDemonstration(NamedTuple):
    """What a file says, unpacked but in its own cell encoding."""

    instruction: Any
    images: np.ndarray  # uint8 (T, 7, 7, 3)
    directions: list[int]
    actions: list[int]


def level_from_name(path: Path) -> str | None:
    """Level that a file's name tells, such as `GoToSeq` for `BabyAI-GoToSeq-v0_valid.pkl`."""
    match = _FILE_NAME.fullmatch(path.name)
    return match["level"] if match else None


def read_demonstrations(path: Path, level: str, encoding: CellEncoding | None = None) -> Iterator[Demonstration]:
    """Read one original file, in its order and in bounded memory.

    Args:
        path: a `.pkl` file of the BabyAI package.
        level: name that the demonstrations will carry.
        encoding: cell encoding; None detects it from the first 1000 demonstrations.

    Yields:
        The demonstrations, with cells as minigrid encodes them. Their seeds are unknown.

    Raises:
        UserError: if the file cannot be read, holds anything but demonstrations, or is in an unknown cell encoding.
    """
    with _errors_name(f"{path}"):
        raw = _raw_demonstrations(path)
        first = list(islice(raw, _DETECT_FROM))
        if not first:
            raise UserError("it holds no demonstrations")
        encoding = encoding or detect(demo.images for demo in first)
        for index, demo in enumerate(chain(first, raw)):
            with _errors_name(f"demonstration {index}"):
                demonstration = _demonstration(demo, level, encoding)
            yield demonstration


def count_demonstrations(path: Path) -> int:
    """Number of demonstrations in a file; raises `UserError` as `read_demonstrations` does."""
    with _errors_name(f"{path}"), _mapped(path) as data:
        return sum(1 for _ in read_items(data, DEMO_PARTS))


@contextmanager
def _errors_name(what: str) -> Iterator[None]:
    """Put the name of a file or of a demonstration in front of what is wrong with it."""
    try:
        yield
    except (PickleRefusedError, UserError) as error:
        raise UserError(f"{what}: {error}") from error


def _raw_demonstrations(path: Path) -> Iterator[RawDemonstration]:
    with _mapped(path) as data:
        for index, item in enumerate(read_items(data, DEMO_PARTS)):
            with _errors_name(f"demonstration {index}"):
                demonstration = _unpacked(item)
            yield demonstration


def _mapped(path: Path) -> mmap.mmap:
    try:
        with path.open("rb") as file:
            if os.fstat(file.fileno()).st_size == 0:
                raise PickleRefusedError("it is empty")
            return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    except OSError as error:
        raise UserError(f"cannot be read: {error.strerror}") from error


def _unpacked(item: Any) -> RawDemonstration:
    if type(item) is not tuple or len(item) != 4:
        raise PickleRefusedError(
            "it holds something else than demonstrations (instruction, images, directions, actions)"
        )
    instruction, packed, directions, actions = item
    if type(directions) is not list or type(actions) is not list or len(directions) != len(actions):
        raise PickleRefusedError("the numbers of directions and actions differ")
    return RawDemonstration(instruction, _images(as_bytes(packed), len(actions)), directions, actions)


def _images(packed: bytes, length: int) -> np.ndarray:
    """Unpack the images of an episode of `length` steps; a buffer that claims to hold more is not even opened."""
    if len(packed) < _BLOSC_HEADER or int.from_bytes(packed[12:16], "little") != len(packed):
        raise PickleRefusedError("its images are not a blosc buffer, or are truncated")
    unpacked_size = int.from_bytes(packed[4:8], "little")
    if unpacked_size > 8 * GRID_SIZE * length + 4096:  # 8: the longest spelling of a byte, in pickle protocol 0
        raise PickleRefusedError(f"its images claim {unpacked_size:,} bytes for {length} steps")
    images = read_value(_decompressed(packed), ARRAY_PARTS)
    if not isinstance(images, np.ndarray) or images.dtype != np.uint8 or images.shape != (length, *GRID_SHAPE):
        raise PickleRefusedError(f"its images are not uint8 {(length, *GRID_SHAPE)}, one for each action")
    return images


def _decompressed(packed: bytes) -> bytes:
    try:
        import blosc  # an extra; only original files need it
    except ImportError as error:
        raise UserError('reading it needs blosc: pip install "lerobot_policy_lisa[babyai]"') from error
    try:
        return blosc.decompress(packed)
    except blosc.blosc_extension.error as error:
        raise PickleRefusedError("its images are a damaged blosc buffer") from error


def _demonstration(demo: RawDemonstration, level: str, encoding: CellEncoding) -> Demonstration:
    grid = to_minigrid(demo.images, encoding).reshape(-1, GRID_SIZE) if len(demo.images) else demo.images
    action = _small_integers(demo.actions, "action")
    direction = _small_integers(demo.directions, "direction").astype(np.uint8)
    return Demonstration(demo.instruction, grid, direction, action, level)


def _small_integers(values: list[int], name: str) -> np.ndarray:
    try:
        return np.frombuffer(bytes(values), np.uint8).astype(np.int64)
    except (OverflowError, TypeError, ValueError) as error:
        raise PickleRefusedError(f"{name} is outside its range") from error
