"""Shards: the demonstrations of a range of seeds, made by one worker and kept on disk until the dataset is written."""

import os
import signal
import zipfile
from collections.abc import Iterator
from functools import cache
from multiprocessing import connection, parent_process
from pathlib import Path
from threading import Thread
from typing import NamedTuple

import numpy as np

from dataset_converters.babyai.bot import demonstrate
from dataset_converters.babyai.demonstration import GRID_SIZE, Demonstration
from lerobot_lisa.envs.babyai.levels import FastLevel, make_level


class SeedRange(NamedTuple):
    """The seeds from `first` up to but not including `stop`."""

    first: int
    stop: int


class ShardCounts(NamedTuple):
    """What came out of a range of seeds."""

    successes: int
    failures: int


_level = cache(make_level)  # one per process: building a level costs more than an easy episode


def follow_parent() -> None:
    """Start a worker process: it leaves Ctrl-C to its parent, and ends when its parent is killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = parent_process()
    if parent is not None:

        def end_with_parent() -> None:
            connection.wait([parent.sentinel])
            os._exit(1)

        Thread(target=end_with_parent, daemon=True).start()


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
    if not _is_complete(path):
        environment: FastLevel = _level(level)
        tried = (demonstrate(environment, level, seed) for seed in range(*seeds))
        _save(path, [demo for demo in tried if demo is not None])
    with np.load(path, allow_pickle=False) as shard:
        successes = len(shard["seed"])
    return ShardCounts(successes, seeds.stop - seeds.first - successes)


def shard_path(folder: Path, seeds: SeedRange) -> Path:
    """Where the shard of a range of seeds lies."""
    return folder / f"seeds-{seeds.first:012d}-{seeds.stop:012d}.npz"


def load_shard(path: Path, level: str) -> Iterator[Demonstration]:
    """The demonstrations of a shard, in the order of their seeds."""
    with np.load(path, allow_pickle=False) as shard:
        columns = {name: shard[name] for name in shard.files}
    ends = np.cumsum(columns["length"])
    for i, (start, end) in enumerate(zip(ends - columns["length"], ends, strict=True)):
        yield Demonstration(
            instruction=str(columns["instruction"][i]),
            grid=columns["grid"][start:end],
            direction=columns["direction"][start:end],
            action=columns["action"][start:end].astype(np.int64),
            level=level,
            seed=int(columns["seed"][i]),
        )


def _save(path: Path, demos: list[Demonstration]) -> None:
    """Write a shard at once or not at all, so that an interruption leaves only whole shards."""
    unfinished = path.with_suffix(".tmp")
    with unfinished.open("wb") as file:
        np.savez_compressed(
            file,
            seed=np.array([demo.seed for demo in demos], np.int64),
            length=np.array([len(demo.action) for demo in demos], np.int64),
            instruction=np.array([demo.instruction for demo in demos], np.str_),
            grid=np.concatenate([np.empty((0, GRID_SIZE), np.uint8), *(demo.grid for demo in demos)]),
            direction=np.concatenate([np.empty(0, np.uint8), *(demo.direction for demo in demos)]),
            action=np.concatenate([np.empty(0, np.uint8), *(demo.action.astype(np.uint8) for demo in demos)]),
        )
    unfinished.replace(path)


def _is_complete(path: Path) -> bool:
    return path.is_file() and zipfile.is_zipfile(path)
