"""Read a dataset's parquet files, a part at a time."""

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from lerobot_lisa.errors import UserError

Array = NDArray[Any]


def tables(root: Path, names: Sequence[str], rows: int = 65_536) -> Iterator[tuple[Path, pa.Table]]:
    """Columns of all frames with the files they are from, so many rows at a time that memory does not matter.

    Raises:
        UserError: A file cannot be read or lacks a column.
    """
    for path in sorted((root / "data").rglob("*.parquet")):
        check_columns(path, names)
        with pq.ParquetFile(path) as file:
            for batch in file.iter_batches(batch_size=rows, columns=list(names)):
                yield path, pa.Table.from_batches([batch])


def check_columns(path: Path, names: Sequence[str]) -> None:
    """Raise `UserError` unless a data file can be read and has these columns."""
    try:
        absent = set(names) - set(pq.read_schema(path).names)
    except (pa.ArrowException, OSError) as error:
        raise UserError(f"{path}: this is no readable parquet file ({error}): fetch the dataset again") from error
    if absent:
        raise UserError(f"{path}: the file has no column `{min(absent)}`: fetch the dataset again")


def values(path: Path, table: pa.Table, key: str, shape: tuple[int, ...] = ()) -> Array:
    """Numbers of a column of scalars or (nested) lists, (rows, *shape); `path` is for the message.

    Raises:
        UserError: Rows have another number of them.
    """
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
