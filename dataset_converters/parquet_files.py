"""A numbered sequence of parquet files that rolls over by size, as LeRobot's writer does."""

from pathlib import Path
from typing import NamedTuple

import pyarrow as pa
import pyarrow.parquet as pq
from lerobot.datasets.utils import update_chunk_file_indices


class FilePlace(NamedTuple):
    """Which file a row group went to."""

    chunk_index: int
    file_index: int


class ParquetFiles:
    """Writes tables as row groups; a new file starts when the next table would pass the size limit."""

    def __init__(self, root: Path, pattern: str, max_bytes: int, files_per_chunk: int) -> None:
        """`pattern` has the fields `chunk_index` and `file_index`, and is relative to `root`."""
        self._root, self._pattern = root, pattern
        self._max_bytes, self._files_per_chunk = max_bytes, files_per_chunk
        self._place = FilePlace(0, 0)
        self._sink: pa.NativeFile | None = None
        self._writer: pq.ParquetWriter | None = None
        self._rows = 0

    def place_for(self, rows: int) -> FilePlace:
        """The file that the next table, of `rows` rows, goes to; rolls over if it would not fit."""
        if self._sink is not None and self._sink.tell() * (1 + rows / self._rows) >= self._max_bytes:
            self.close()
            self._place = FilePlace(*update_chunk_file_indices(*self._place, self._files_per_chunk))
        return self._place

    def write(self, table: pa.Table) -> FilePlace:
        """Append `table` as one row group and return where it went."""
        place = self.place_for(table.num_rows)
        if self._writer is None:
            path = self._root / self._pattern.format(**place._asdict())
            path.parent.mkdir(parents=True, exist_ok=True)
            self._sink = pa.OSFile(str(path), "wb")
            self._writer = pq.ParquetWriter(self._sink, table.schema, compression="snappy", use_dictionary=True)
        self._writer.write_table(table)
        self._rows += table.num_rows
        return place

    def close(self) -> None:
        """Write the footer of the open file; without it a parquet file cannot be read."""
        if self._writer is not None and self._sink is not None:
            self._writer.close()
            self._sink.close()
        self._writer = self._sink = None
        self._rows = 0
