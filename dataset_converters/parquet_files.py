"""A numbered sequence of parquet files that rolls over by size, as LeRobot's writer does."""

from pathlib import Path
from typing import NamedTuple

import pyarrow as pa
import pyarrow.parquet as pq
from lerobot.datasets.utils import update_chunk_file_indices

_GROUP_BYTES = 8 * 1024**2  # readers pay for each row group; one per episode made short episodes slow to open


class FilePlace(NamedTuple):
    """Which file a table went to."""

    chunk_index: int
    file_index: int


class ParquetFiles:
    """Writes tables one after the other, several to a row group; a file ends before it would pass the size limit."""

    def __init__(self, root: Path, pattern: str, max_bytes: int, files_per_chunk: int) -> None:
        """`pattern` has the fields `chunk_index` and `file_index`, and is relative to `root`."""
        self._root, self._pattern = root, pattern
        self._max_bytes, self._files_per_chunk = max_bytes, files_per_chunk
        self._group_bytes = min(_GROUP_BYTES, max_bytes // 8)
        self._place = FilePlace(0, 0)
        self._sink: pa.NativeFile | None = None
        self._writer: pq.ParquetWriter | None = None
        self._waiting: list[pa.Table] = []
        self._rows = self._waiting_bytes = 0

    def place_for(self, rows: int) -> FilePlace:
        """The file that the next table, of `rows` rows, goes to; rolls over if it would not fit."""
        if self._rows and self._size * (1 + rows / self._rows) >= self._max_bytes:
            self.close()
            self._place = FilePlace(*update_chunk_file_indices(*self._place, self._files_per_chunk))
        return self._place

    @property
    def _size(self) -> int:
        """Bytes of the open file, what waits counted before compression."""
        return self._waiting_bytes + (self._sink.tell() if self._sink is not None else 0)

    def write(self, table: pa.Table) -> FilePlace:
        """Append `table` and return where it goes."""
        place = self.place_for(table.num_rows)
        self._waiting.append(table)
        self._waiting_bytes += table.nbytes
        self._rows += table.num_rows
        if self._waiting_bytes >= self._group_bytes:
            self._write_group()
        return place

    def _write_group(self) -> None:
        tables, self._waiting, self._waiting_bytes = (
            self._waiting,
            [],
            0,
        )  # at once: a full disk must not be tried again
        group = pa.concat_tables(tables).combine_chunks()
        if self._writer is None:
            path = self._root / self._pattern.format(**self._place._asdict())
            path.parent.mkdir(parents=True, exist_ok=True)
            self._sink = pa.OSFile(str(path), "wb")
            self._writer = pq.ParquetWriter(self._sink, group.schema, compression="snappy", use_dictionary=True)
        self._writer.write_table(group)

    def close(self) -> None:
        """Write what waits and the footer of the open file; without it a parquet file cannot be read."""
        if self._waiting:
            self._write_group()
        if self._writer is not None and self._sink is not None:
            self._writer.close()
            self._sink.close()
        self._writer = self._sink = None
        self._rows = 0
