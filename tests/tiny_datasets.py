"""Datasets of a few short episodes, one for each kind of feature that the policies take."""

from pathlib import Path

import numpy as np

from dataset_converters.writer import DatasetLayout, Episode, write_dataset

LENGTHS = [7, 1, 10, 11, 23, 4]  # below, at and above a horizon of 10, and a single frame
INSTRUCTIONS = [
    "go to the red ball",
    "open a door",
    "pick up the grey key, then put it next to the blue box",
    "go to the red ball",
    "go",
    "open the yellow door behind you",
]
GRID = {"dtype": "uint8", "shape": (147,), "names": [f"cell_{i}" for i in range(147)]}
DIRECTION = {"dtype": "uint8", "shape": (1,), "names": ["direction"]}
CLASSES = {"dtype": "int64", "shape": (1,), "names": {"classes": [*"lrfpdto"]}}
STATE = {"dtype": "float32", "shape": (3,), "names": ["x", "y", "z"]}
MOVE = {"dtype": "float32", "shape": (2,), "names": ["dx", "dy"]}
CAMERA = {"dtype": "image", "shape": (8, 6, 3), "names": ["height", "width", "channels"]}


def write(root: Path, features: dict, lengths: list[int] = LENGTHS, seed: int = 0) -> Path:
    """A dataset of random episodes with the given features."""
    rng = np.random.default_rng(seed)
    episodes = [
        Episode(
            INSTRUCTIONS[i % len(INSTRUCTIONS)],
            {key: _random(rng, key, length, feature) for key, feature in features.items()},
        )
        for i, length in enumerate(lengths)
    ]
    write_dataset(root, DatasetLayout("local/tiny", 10, features), episodes)
    return root


def symbolic(root: Path, lengths: list[int] = LENGTHS, seed: int = 0) -> Path:
    """BabyAI's features."""
    return write(root, {"observation.grid": GRID, "observation.direction": DIRECTION, "action": CLASSES}, lengths, seed)


def continuous(root: Path, lengths: list[int] = LENGTHS, seed: int = 0) -> Path:
    """Real-valued states and actions, far from mean 0 and deviation 1."""
    return write(root, {"observation.state": STATE, "action": MOVE}, lengths, seed)


def pictures(root: Path, lengths: list[int] = LENGTHS, seed: int = 0) -> Path:
    """Images that are neither square nor alike, and a state."""
    features = {"observation.images.front": CAMERA, "observation.state": STATE, "action": MOVE}
    return write(root, features, lengths, seed)


def _random(rng: np.random.Generator, key: str, length: int, feature: dict) -> np.ndarray:
    shape = (length, *feature["shape"])
    if feature["dtype"] == "image":
        return rng.integers(0, 256, shape, dtype=np.uint8)
    if feature["dtype"].startswith("float"):
        return (5 + 3 * rng.normal(size=shape)).astype(feature["dtype"])
    highest = {"observation.grid": 11, "observation.direction": 4, "action": 7}.get(key, 4)
    return rng.integers(0, highest, shape).astype(feature["dtype"])
