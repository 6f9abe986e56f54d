"""What a BabyAI demonstration looks like as an episode of a LeRobot dataset."""

from collections.abc import Iterable, Iterator
from typing import Any

import pyarrow as pa

from dataset_converters.babyai.demonstration import ACTIONS, DIRECTIONS, GRID_SIZE, Demonstration
from dataset_converters.writer import DatasetLayout, Episode

FPS = 10
FEATURES: dict[str, dict[str, Any]] = {
    "observation.grid": {
        "dtype": "uint8",
        "shape": (GRID_SIZE,),
        "names": [
            f"{channel}_{column}_{row}"
            for column in range(7)
            for row in range(7)
            for channel in ("object", "color", "state")
        ],
    },
    "observation.direction": {"dtype": "uint8", "shape": (1,), "names": {"classes": list(DIRECTIONS)}},
    "action": {"dtype": "int64", "shape": (1,), "names": {"classes": list(ACTIONS)}},
}
EPISODE_COLUMNS = {"level": pa.string(), "seed": pa.int64(), "source_index": pa.int64()}
"""Columns of meta/episodes beyond LeRobot's own. `seed` is null for converted files, `source_index` for generated."""


def babyai_layout(repo_id: str) -> DatasetLayout:
    """Layout of every BabyAI dataset, whatever its level and origin."""
    return DatasetLayout(repo_id, FPS, FEATURES, EPISODE_COLUMNS)


def to_episodes(demonstrations: Iterable[tuple[Demonstration, int | None]]) -> Iterator[Episode]:
    """Turn demonstrations, each with its index in the source file if it has one, into episodes."""
    for demo, source_index in demonstrations:
        yield Episode(
            task=demo.instruction,
            frames={
                "observation.grid": demo.grid,
                "observation.direction": demo.direction,
                "action": demo.action,
            },
            metadata={"level": demo.level, "seed": demo.seed, "source_index": source_index},
        )
