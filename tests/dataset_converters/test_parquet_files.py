"""Many small tables end in few row groups, in order and in the files that they were promised."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dataset_converters.parquet_files import ParquetFiles


def table(first: int, rows: int, noise: np.random.Generator) -> pa.Table:
    return pa.table({"index": np.arange(first, first + rows), "noise": noise.random(rows)})


def write(root: Path, lengths: list[int], max_bytes: int) -> list[tuple[int, int]]:
    files = ParquetFiles(root, "{chunk_index}-{file_index}.parquet", max_bytes, files_per_chunk=1000)
    noise, first = np.random.default_rng(0), 0
    places: list[tuple[int, int]] = []
    for rows in lengths:
        places.append((*files.write(table(first, rows, noise)),))
        first += rows
    files.close()
    return places


@given(st.lists(st.integers(1, 400), min_size=1, max_size=60), st.sampled_from([4_000, 20_000, 10**8]))
@settings(max_examples=30, deadline=None)
def test_every_row_is_where_it_was_said_to_be(
    tmp_path_factory: pytest.TempPathFactory, lengths: list[int], max_bytes: int
) -> None:
    root, first = tmp_path_factory.mktemp("files"), 0
    places = write(root, lengths, max_bytes)

    held = {path.name: pq.read_table(path)["index"].to_pylist() for path in root.iterdir()}
    for rows, (chunk, file) in zip(lengths, places, strict=True):
        assert set(range(first, first + rows)) <= set(held[f"{chunk}-{file}.parquet"])
        first += rows
    assert sum(map(len, held.values())) == sum(lengths)
    for indices in held.values():
        assert indices == sorted(indices)


def test_short_episodes_share_row_groups(tmp_path: Path) -> None:
    write(tmp_path, [20] * 5_000, max_bytes=10**8)

    assert pq.ParquetFile(tmp_path / "0-0.parquet").num_row_groups == 1


def test_no_file_passes_the_limit(tmp_path: Path) -> None:
    places = write(tmp_path, [200] * 400, max_bytes=100_000)

    assert len(set(places)) > 5
    assert max(path.stat().st_size for path in tmp_path.iterdir()) <= 110_000  # the footer comes on top
