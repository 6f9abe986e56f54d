"""Rows of meta/episodes: where an episode's frames are, its statistics, and what else is known about it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from dataset_converters.parquet_files import FilePlace
from dataset_converters.stats import EpisodeStats


@dataclass(frozen=True)
class EpisodeRow:
    """One episode of a dataset, as far as its metadata is concerned."""

    episode_index: int
    task: str
    length: int
    first_frame: int
    data_file: FilePlace
    metadata: Mapping[str, int | float | str | None]
    stats: EpisodeStats


def episode_table(rows: Sequence[EpisodeRow], place: FilePlace, extra: Mapping[str, pa.DataType]) -> pa.Table:
    """Table of a block of episodes, to be written to the meta/episodes file `place`.

    LeRobot's tools read their own columns and leave the `extra` ones alone.
    """
    columns: dict[str, pa.Array] = {
        "episode_index": _integers([row.episode_index for row in rows]),
        "tasks": pa.array([[row.task] for row in rows], type=pa.list_(pa.string())),
        "length": _integers([row.length for row in rows]),
        "data/chunk_index": _integers([row.data_file.chunk_index for row in rows]),
        "data/file_index": _integers([row.data_file.file_index for row in rows]),
        "dataset_from_index": _integers([row.first_frame for row in rows]),
        "dataset_to_index": _integers([row.first_frame + row.length for row in rows]),
        **_stats_columns([row.stats for row in rows]),
        "meta/episodes/chunk_index": _integers([place.chunk_index] * len(rows)),
        "meta/episodes/file_index": _integers([place.file_index] * len(rows)),
        **{key: pa.array([row.metadata.get(key) for row in rows], type=kind) for key, kind in extra.items()},
    }
    return pa.table(columns)


def _integers(values: list[int]) -> pa.Array:
    return pa.array(values, type=pa.int64())


def _stats_columns(stats: Sequence[EpisodeStats]) -> dict[str, pa.Array]:
    return {
        f"stats/{key}/{name}": _lists(np.stack([episode[key][name] for episode in stats]))
        for key, names in stats[0].items()
        for name in names
    }


def _lists(values: np.ndarray) -> pa.Array:
    """(E, D, ...) array as an Arrow array of E nested lists, without going through Python objects."""
    array = pa.array(values.reshape(-1))
    for depth in range(values.ndim - 1, 0, -1):
        count, width = int(np.prod(values.shape[:depth])), values.shape[depth]
        offsets = pa.array(np.arange(count + 1, dtype=np.int32) * width)
        array = pa.ListArray.from_arrays(offsets, array)
    return array
