"""Whether a dataset keeps what its metadata promise: each frame there once, in one episode, all numbers finite.

What is wrong here would otherwise be trained on without a word: frames that were never written, another episode's,
or one that is not a number, after which no weight is.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pyarrow.parquet as pq

from lerobot_lisa.episodes.tables import Array, check_columns
from lerobot_lisa.errors import UserError

if TYPE_CHECKING:
    from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata

_LARGEST = 1e18  # squares of greater numbers are infinite in float32, and so are losses
_RECOMPUTE = "lerobot-edit-dataset --operation.type=recompute_stats"


class Bounds(NamedTuple):
    """Least and greatest permitted value of a feature, and who permits them."""

    low: float
    high: float
    by: str

    def hold(self, values: Array) -> bool:
        """Whether all values lie within; not a number lies nowhere."""
        return not values.size or bool(values.min() >= self.low and values.max() <= self.high)


def bounds(meta: "LeRobotDatasetMetadata", key: str) -> Bounds:
    """What a feature may hold: finite real numbers, and integers that the statistics know.

    Raises:
        UserError: The statistics are no numbers.
    """
    if not meta.features[key]["dtype"].startswith(("int", "uint")):
        return Bounds(-_LARGEST, _LARGEST, "")
    stats = (meta.stats or {}).get(key)
    if stats is None:
        return Bounds(-np.inf, np.inf, "")
    return Bounds(float(np.min(stats["min"])), float(np.max(stats["max"])), "meta/stats.json")


def check_metadata(meta: "LeRobotDatasetMetadata", keys: Sequence[str]) -> tuple[Array, Array]:
    """Check everything that needs no frame, before a network is built.

    Args:
        meta: The dataset.
        keys: Features that will be read.

    Returns:
        `episode_spans`.

    Raises:
        UserError: A feature is not there, its statistics are not finite, instructions are missing, or episodes do not
            share out the frames.
    """
    _check_tasks(meta)
    for key in keys:
        if key not in meta.features:
            raise UserError(f"{meta.root}: the dataset has no feature `{key}`; it has {', '.join(meta.features)}")
        for name, numbers in ((meta.stats or {}).get(key) or {}).items():
            if not np.isfinite(np.asarray(numbers, np.float64)).all():
                where = _worst_episode(Path(meta.root), key, name)
                raise UserError(
                    f"{meta.root}: `{key}` is not finite{where} (meta/stats.json, {name}): mend or delete what is not, "
                    f"then run {_RECOMPUTE}"
                )
    for path in sorted((Path(meta.root) / "data").rglob("*.parquet"))[:1]:
        check_columns(path, [key for key in keys if meta.features[key]["dtype"] != "video"])
    return episode_spans(meta)


def _check_tasks(meta: "LeRobotDatasetMetadata") -> None:
    tasks = [task for task in meta.tasks.index if isinstance(task, str)]
    if len(tasks) < max(meta.total_tasks, 1):
        raise UserError(
            f"{meta.root}: meta/tasks.parquet holds {len(tasks)} instructions, but meta/info.json counts "
            f"{meta.total_tasks}: fetch the dataset again"
        )


def _worst_episode(root: Path, key: str, name: str) -> str:
    """Names the first episode whose own statistics are not finite, if episodes have some."""
    column = f"stats/{key}/{name}"
    for path in sorted((root / "meta/episodes").rglob("*.parquet")):
        if column in pq.read_schema(path).names:
            table = pq.read_table(path, columns=["episode_index", column])
            for episode, numbers in zip(*(part.to_pylist() for part in table.columns), strict=True):
                if not np.isfinite(np.asarray(numbers, np.float64)).all():
                    return f" in episode {episode}"
    return ""


def episode_spans(meta: "LeRobotDatasetMetadata") -> tuple[Array, Array]:
    """First frames of the episodes, and the frames after their last ones, (episodes,) each.

    Raises:
        UserError: They do not share out the dataset's frames among them, one after another.
    """
    starts, stops = (np.asarray(meta.episodes[f"dataset_{end}_index"][:]) for end in ("from", "to"))
    expected = np.concatenate([[0], stops[:-1]])
    wrong = np.flatnonzero((starts != expected) | (stops <= starts))
    if len(wrong):
        episode = int(wrong[0])
        raise UserError(
            f"{meta.root}: meta/episodes gives episode {episode} the frames from {starts[episode]} up to "
            f"{stops[episode]}, but it must begin at {expected[episode]} and have some: fetch the dataset again"
        )
    if stops[-1:].sum() != meta.total_frames:
        raise UserError(
            f"{meta.root}: its {len(stops)} episodes have {stops[-1:].sum()} frames, but meta/info.json counts "
            f"{meta.total_frames}: fetch the dataset again"
        )
    return starts, stops


class FrameLedger:
    """Notes which frames have been read.

    Args:
        root: Folder of the dataset, for messages.
        starts: First frame of each episode.
        stops: The frame after the last one of each.
        present: Whether an episode's data file is there.
    """

    def __init__(self, root: Path | str, starts: Array, stops: Array, present: Array) -> None:
        self._root, self.present = root, present
        self._episode = np.repeat(np.arange(len(starts)), stops - starts)  # of each frame
        self._read = np.zeros(len(self._episode), bool)

    def note(self, frames: Array, episodes: Array) -> Array | slice:
        """Note rows of a file.

        Args:
            frames: Their numbers, (n,).
            episodes: The episodes that they say they belong to, (n,).

        Returns:
            Where they belong among all frames; a slice if they follow one another.

        Raises:
            UserError: A frame has no place, was there before, or is another episode's.
        """
        count = len(self._read)
        if len(outside := frames[(frames < 0) | (frames >= count)]):
            raise UserError(
                f"{self._root}: data files hold frame {outside[0]}, but the dataset has {count} frames: fetch it again"
            )
        where = slice(frames[0], frames[0] + len(frames)) if (np.diff(frames) == 1).all() and len(frames) else frames
        self._refuse(frames, self._episode[where] != episodes, "says in its row that it is another episode's")
        self._refuse(frames, self._read[where], "is there twice")
        self._read[where] = True
        if where is frames and len(np.unique(frames)) < len(frames):
            ordered = np.sort(frames)
            self._refuse(ordered[1:], ordered[1:] == ordered[:-1], "is there twice")
        return where

    def check_complete(self) -> None:
        """Raise `UserError` unless every frame of the episodes that are present has been read."""
        if not self._read.all():
            missing = np.flatnonzero(~self._read & self.present[self._episode])
            self._refuse(missing, np.ones_like(missing, bool), f"is one of {len(missing)} that no data file holds")

    def check_values(self, key: str, values: Array, frames: Array, allowed: Bounds) -> None:
        """Raise `UserError` if values (n, *shape) of a feature are not allowed in these frames, (n,)."""
        if allowed.hold(values):
            return
        flat = values.reshape(len(frames), -1)
        wrong = ~((flat >= allowed.low) & (flat <= allowed.high))
        row = int(np.flatnonzero(wrong.any(1))[0])
        why = (
            f"but {allowed.by} promises {allowed.low:g} to {allowed.high:g}: run {_RECOMPUTE}"
            if allowed.by
            else "which cannot be learned from: mend or delete the episode (lerobot-edit-dataset)"
        )
        self._refuse(frames[[row]], np.ones(1, bool), f"holds {flat[row][wrong[row]][0]} in `{key}`, {why}", fix="")

    def _refuse(self, frames: Array, wrong: Array, problem: str, fix: str = ": fetch the dataset again") -> None:
        """Name the first of the frames that is `wrong`, if any is."""
        if wrong.any():
            frame = int(frames[np.flatnonzero(wrong)[0]])
            raise UserError(f"{self._root}: frame {frame} (episode {self._episode[frame]}) {problem}{fix}")
