"""What a BabyAI demonstration looks like as an episode of a LeRobot dataset."""

from collections.abc import Iterable, Iterator
from typing import Any

import pyarrow as pa
from minigrid.core.constants import COLOR_TO_IDX, OBJECT_TO_IDX, STATE_TO_IDX

from dataset_converters.babyai.demonstration import ACTIONS, DIRECTIONS, GRID_SHAPE, GRID_SIZE, Demonstration
from dataset_converters.writer import DatasetLayout, Episode

FPS = 10
_KINDS, _COLORS, _STATES = (sorted(numbers, key=numbers.get) for numbers in (OBJECT_TO_IDX, COLOR_TO_IDX, STATE_TO_IDX))

GRID_SYMBOLS: dict[str, Any] = {
    "axes": ["column", "row", "channel"],
    "shape": list(GRID_SHAPE),
    "naming": ["kind", "color"],  # a state, such as open, is nothing that a thing is called
    "channels": [
        {"name": "kind", "words": _KINDS},
        {"name": "color", "words": _COLORS},
        {"name": "state", "words": _STATES},
    ],
}
"""What the numbers of the grid are called, by channel: number n is the n-th word."""

DIRECTION_SYMBOLS: dict[str, Any] = {"shape": [1], "channels": [{"name": "direction", "words": list(DIRECTIONS)}]}

SYMMETRIES: dict[str, Any] = {
    "mirror": {
        "axis": "column",
        "swap_actions": [["left", "right"]],
        "swap_words": [["left", "right"]],
        "swap_symbols": {"observation.direction": [["right", "left"]]},
    },
    "permute": [
        {"channel": "color", "words": _COLORS, "where": {"kind": ["door", "key", "ball", "box"]}},
        {"channel": "kind", "words": ["key", "ball", "box"], "unless": {"kind": ["door"], "state": ["locked"]}},
    ],
}
"""Changes of an episode after which it is again one that BabyAI could have shown, in the words of the instruction too.

`mirror` flips the world from left to right: the view's columns are reversed, "on your left" becomes "on your right",
and "in front of you" and "behind you" stay. `permute` renames symbols, in the grid and in the instruction: colors only
`where` a cell holds something that has a color (walls stay grey, and empty cells count as the first color), kinds
`unless` the episode shows a locked door, which only a key opens. The bot never opens boxes, so these are alike to it.
"""

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
        "info": {"symbols": GRID_SYMBOLS, "symmetries": SYMMETRIES},
    },
    "observation.direction": {
        "dtype": "uint8",
        "shape": (1,),
        "names": {"classes": list(DIRECTIONS)},
        "info": {"symbols": DIRECTION_SYMBOLS},
    },
    "action": {"dtype": "int64", "shape": (1,), "names": {"classes": list(ACTIONS)}},
}
EPISODE_COLUMNS = {"level": pa.string(), "seed": pa.int64(), "source_index": pa.int64()}
"""Columns of meta/episodes beyond LeRobot's own. `seed` is null for converted files, `source_index` for generated."""


def babyai_layout(repo_id: str, subtasks: bool = False) -> DatasetLayout:
    """Layout of every BabyAI dataset, whatever its level and origin; `subtasks`: with the parts of its instructions."""
    return DatasetLayout(repo_id, FPS, FEATURES, EPISODE_COLUMNS, subtasks=subtasks)


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
            subtasks=demo.subtasks,
        )
