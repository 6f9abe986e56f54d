"""Shards: the demonstrations of a range of seeds, made by one worker and kept on disk until the dataset is written."""

from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from dataset_converters.babyai.bot import demonstrate
from dataset_converters.babyai.demonstration import GRID_SIZE, Demonstration
from dataset_converters.seeds import SeedRange
from dataset_converters.shard_files import is_complete, load_arrays, save_arrays, shard_path
from dataset_converters.subtasks import Subtask
from lerobot_lisa.envs.babyai.levels import FastLevel, make_level


class ShardCounts(NamedTuple):
    """What came out of a range of seeds."""

    successes: int
    failures: int


_level = cache(make_level)  # one per process: building a level costs more than an easy episode


def make_shard(folder: Path, level: str, seeds: SeedRange) -> ShardCounts:
    """Demonstrate `level` for each seed and keep the successes; a shard that is there already is only counted.

    Args:
        folder: existing directory for shards.
        level: name of the level.
        seeds: one episode each.

    Returns:
        The numbers of successes and failures.
    """
    path = shard_path(folder, seeds)
    if not is_complete(path):
        environment: FastLevel = _level(level)
        tried = (demonstrate(environment, level, seed) for seed in range(*seeds))
        _save(path, [demo for demo in tried if demo is not None])
    with np.load(path, allow_pickle=False) as shard:
        successes = len(shard["seed"])
    return ShardCounts(successes, seeds.stop - seeds.first - successes)


def load_shard(path: Path, level: str) -> Iterator[Demonstration]:
    """The demonstrations of a shard, in the order of their seeds."""
    columns = load_arrays(path)
    ends = np.cumsum(columns["length"])
    subtasks = _subtasks(columns)
    for i, (start, end) in enumerate(zip(ends - columns["length"], ends, strict=True)):
        yield Demonstration(
            instruction=str(columns["instruction"][i]),
            grid=columns["grid"][start:end],
            direction=columns["direction"][start:end],
            action=columns["action"][start:end].astype(np.int64),
            level=level,
            seed=int(columns["seed"][i]),
            subtasks=subtasks[i],
        )


def _subtasks(columns: dict[str, np.ndarray]) -> list[tuple[Subtask, ...]]:
    """Those of each demonstration; none in shards of a run that an earlier version began."""
    if "subtasks" not in columns:
        return [()] * len(columns["seed"])
    frames, texts = columns["subtask_frame"].tolist(), columns["subtask_text"].tolist()
    ends = np.cumsum(columns["subtasks"])
    return [
        tuple(map(Subtask, frames[start:end], texts[start:end]))
        for start, end in zip(ends - columns["subtasks"], ends, strict=True)
    ]


def _save(path: Path, demos: list[Demonstration]) -> None:
    subtasks = [subtask for demo in demos for subtask in demo.subtasks]
    save_arrays(
        path,
        seed=np.array([demo.seed for demo in demos], np.int64),
        length=np.array([len(demo.action) for demo in demos], np.int64),
        instruction=np.array([demo.instruction for demo in demos], np.str_),
        grid=np.concatenate([np.empty((0, GRID_SIZE), np.uint8), *(demo.grid for demo in demos)]),
        direction=np.concatenate([np.empty(0, np.uint8), *(demo.direction for demo in demos)]),
        action=np.concatenate([np.empty(0, np.uint8), *(demo.action.astype(np.uint8) for demo in demos)]),
        subtasks=np.array([len(demo.subtasks) for demo in demos], np.int64),
        subtask_frame=np.array([subtask.frame for subtask in subtasks], np.int64),
        subtask_text=np.array([subtask.text for subtask in subtasks], np.str_),
    )
