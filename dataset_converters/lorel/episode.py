"""One episode of random play on the tabletop, wherever it comes from."""

from dataclasses import dataclass

import numpy as np

IMAGE_SHAPE = (64, 64, 3)

_UNLABELLED = ("nothing", "nan", "wave")


@dataclass(frozen=True)
class LorelEpisode:
    """What was seen before each of T actions, and what the episode shows in words."""

    label: str
    state: np.ndarray  # (T, 15) float32
    action: np.ndarray  # (T, 5) float32
    images: np.ndarray | None = None  # (T, 64, 64, 3) uint8
    seed: int | None = None
    source_index: int | None = None
    engine: str | None = None  # such as "mujoco 3.16.0"


def is_labelled(label: str) -> bool:
    """Whether a label says that something happened; the LISA paper leaves out the others, by these substrings."""
    return not any(word in label for word in _UNLABELLED)
