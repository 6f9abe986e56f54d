"""Frame columns: checks episodes against the features and turns arrays into one Arrow table per episode."""

import io
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pyarrow as pa
from lerobot.utils.constants import DEFAULT_FEATURES
from PIL import Image

from dataset_converters.instructions import check_instruction
from lerobot_lisa.errors import UserError

_NUMERIC = {"bool", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)), "float32", "float64"}


def check_features(features: Mapping[str, Mapping[str, Any]]) -> None:
    """Raise `UserError` for a feature that this writer cannot store exactly as LeRobot's would."""
    for key, feature in features.items():
        dtype, shape = feature["dtype"], tuple(feature["shape"])
        if key in DEFAULT_FEATURES or "/" in key:
            raise UserError(f"feature {key}: this name is reserved by LeRobot or holds a slash; rename it")
        if dtype == "image" and len(shape) == 3 and shape[-1] == 3:
            continue
        if dtype not in _NUMERIC or len(shape) != 1:
            raise UserError(
                f"feature {key}: dtype {dtype} with shape {shape} is not supported by the bulk writer; use a numeric "
                "vector, an image of shape (H, W, 3), or LeRobot's add_frame"
            )


def check_episode(
    index: int, task: str, frames: Mapping[str, np.ndarray], features: Mapping[str, Mapping[str, Any]]
) -> int:
    """Return the number of frames T of an episode.

    Raises:
        UserError: if the task is not one line of text, a value is not finite, or if features, dtypes, shapes or lengths
            do not fit.
    """
    check_instruction(task, f"episode {index}: the task")
    if frames.keys() != features.keys():
        raise UserError(f"episode {index}: has features {sorted(frames)}, the dataset has {sorted(features)}")
    length = len(next(iter(frames.values())))
    if length == 0:
        raise UserError(f"episode {index}: has no frames; leave it out")
    for key, feature in features.items():
        values, shape = frames[key], tuple(feature["shape"])
        dtype = "uint8" if feature["dtype"] == "image" else feature["dtype"]
        if values.dtype != dtype or values.shape not in _shapes(length, shape):
            raise UserError(
                f"episode {index}: {key} is {values.dtype} {values.shape}, expected {dtype} {(length, *shape)}"
            )
        if values.dtype.kind == "f" and not np.isfinite(values).all():
            frame = int(np.argwhere(~np.isfinite(values))[0, 0])
            raise UserError(f"episode {index}: {key} is NaN or infinite at frame {frame}; mend it or leave it out")
    return length


def _shapes(length: int, shape: tuple[int, ...]) -> tuple[tuple[int, ...], ...]:
    return ((length,), (length, 1)) if shape == (1,) else ((length, *shape),)


def frame_table(
    columns: Mapping[str, np.ndarray | pa.Array], features: Mapping[str, Mapping[str, Any]], schema: pa.Schema
) -> pa.Table:
    """Arrow table of one episode: one row per frame, one column per feature, with LeRobot's own types.

    Columns that are arrays of Arrow already stay as they are.
    """
    arrays = [_column(columns[key], feature, schema.field(key).type) for key, feature in features.items()]
    return pa.Table.from_arrays(arrays, schema=schema)


def _column(values: np.ndarray | pa.Array, feature: Mapping[str, Any], kind: pa.DataType) -> pa.Array:
    if isinstance(values, pa.Array):
        return values
    return _image_column(values, kind) if feature["dtype"] == "image" else _numeric_column(values, kind)


def _numeric_column(values: np.ndarray, kind: pa.DataType) -> pa.Array:
    flat = pa.array(np.ascontiguousarray(values).reshape(-1))
    return pa.FixedSizeListArray.from_arrays(flat, type=kind) if pa.types.is_fixed_size_list(kind) else flat


def _image_column(images: np.ndarray, kind: pa.DataType) -> pa.Array:
    """PNG bytes with the file name that LeRobot's recorder would have used; packing them is half of writing."""
    with ThreadPoolExecutor() as pool:  # Pillow lets other threads work meanwhile
        cells = [{"bytes": png, "path": f"frame-{i:06d}.png"} for i, png in enumerate(pool.map(_png, images))]
    return pa.array(cells, type=kind)


def _png(image: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, format="png", compress_level=6)
    return buffer.getvalue()
