"""The subtasks that a dataset is annotated with, frame by frame, as LeRobot's own tools read them."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
from lerobot.datasets.language import LANGUAGE_PERSISTENT
from numpy.typing import NDArray

from lerobot_lisa.episodes.check import episode_spans
from lerobot_lisa.episodes.tables import tables, values
from lerobot_lisa.errors import UserError

if TYPE_CHECKING:
    from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata

SUBTASK = "subtask"
HOW = "annotate it with lerobot-annotate, or generate BabyAI's with --subtasks"
_FIELDS = {"content", "style", "timestamp"}
_ROWS = 1024  # at a time: each repeats everything that its episode is annotated with

Row = tuple[float, str]  # from which second on, and what


@dataclass(frozen=True)
class Subtasks:
    """Which subtask is active at each frame of a dataset.

    Attributes:
        labels: The S different ones.
        frames: Place among them of each frame's, (N,); -1 where none is annotated.
    """

    labels: list[str]
    frames: NDArray[np.int64]


def read_subtasks(meta: "LeRobotDatasetMetadata", style: str = SUBTASK) -> Subtasks:
    """Read annotations of a style that lasts until the next one, such as "subtask" or "plan".

    Raises:
        UserError: The dataset has none, or a file is not as `lerobot-annotate` writes it.
    """
    if LANGUAGE_PERSISTENT not in meta.features:
        raise UserError(f"{meta.root}: it has no annotated subtasks (`{LANGUAGE_PERSISTENT}`): {HOW}")
    starts, stops = episode_spans(meta)
    times, rows = _read(meta, starts)
    frames, places = np.full(meta.total_frames, -1), dict[str, int]()
    styles = {str(name) for listed in rows.values() for name in listed}
    for start, stop in zip(starts, stops, strict=True):
        listed = sorted(rows.get(int(start), {}).get(style, []), key=lambda row: row[0])
        if listed:
            last = np.searchsorted([begin for begin, _ in listed], times[start:stop], side="right") - 1
            numbers = np.array([places.setdefault(text, len(places)) for _, text in listed])
            frames[start:stop] = np.where(last >= 0, numbers[last], -1)
    if not places:
        there = f"only {', '.join(sorted(styles))}" if styles else "nothing"
        raise UserError(f"{meta.root}: `{LANGUAGE_PERSISTENT}` holds no {style}, {there}: {HOW}")
    return Subtasks(list(places), frames)


def _read(
    meta: "LeRobotDatasetMetadata", starts: NDArray[np.int64]
) -> tuple[NDArray[np.float64], dict[int, dict[str, list[Row]]]]:
    """Seconds of each frame, (N,), and by each episode's first frame its rows by style."""
    times, found = np.zeros(meta.total_frames), dict[int, dict[str, list[Row]]]()
    for path, table in tables(Path(meta.root), ["index", "timestamp", LANGUAGE_PERSISTENT], _ROWS):
        frames = values(path, table, "index")
        known = (frames >= 0) & (frames < len(times))  # others are refused where frames are read
        times[frames[known]] = values(path, table, "timestamp")[known]
        first = np.flatnonzero(np.isin(frames, starts))
        listed = _rows(path, table.column(LANGUAGE_PERSISTENT), first)
        found.update(zip(frames[first].tolist(), listed, strict=True))
    return times, found


def _rows(path: Path, column: pa.ChunkedArray, chosen: NDArray[np.int64]) -> Iterator[dict[str, list[Row]]]:
    kind = column.type
    cell = kind.value_type if pa.types.is_list(kind) or pa.types.is_large_list(kind) else kind
    named = {cell.field(place).name for place in range(cell.num_fields)} if pa.types.is_struct(cell) else set()
    if not (named >= _FIELDS or pa.types.is_null(cell)):  # null: no episode of the file is annotated
        raise UserError(f"{path}: `{LANGUAGE_PERSISTENT}` is {kind}, which lerobot-annotate does not write")
    for listed in column.take(pa.array(chosen)).to_pylist():
        yield _by_style(path, listed or [])


def _by_style(path: Path, listed: list[dict[str, Any]]) -> dict[str, list[Row]]:
    """The rows that say something."""
    found: dict[str, list[Row]] = {}
    for row in listed:
        if row["content"]:
            if row["timestamp"] is None or not math.isfinite(row["timestamp"]):
                raise UserError(f"{path}: {row['content'][:80]!r} begins at {row['timestamp']}, which is no time")
            found.setdefault(str(row["style"]), []).append((row["timestamp"], row["content"]))
    return found
