"""One demonstration of a BabyAI level, checked once where it enters."""

from dataclasses import dataclass

import numpy as np

from dataset_converters.instructions import check_instruction
from dataset_converters.subtasks import Subtask, check_subtasks
from lerobot_lisa.errors import UserError

ACTIONS = ("left", "right", "forward", "pickup", "drop", "toggle", "done")
DIRECTIONS = ("right", "down", "left", "up")
GRID_SHAPE = (7, 7, 3)  # column, row, (object, color, state), as minigrid's partial view
GRID_SIZE = 147


@dataclass(frozen=True)
class Demonstration:
    """A successful episode of T steps: frame t is what is seen before action t.

    Attributes:
        instruction: what was asked for, in BabyAI's English.
        grid: uint8 (T, 147), the 7x7x3 partial view in C order.
        direction: uint8 (T,), 0..3, see `DIRECTIONS`.
        action: int64 (T,), 0..6, see `ACTIONS`.
        level: name such as `GoToSeq`.
        seed: seed of the reset that made the episode, if known.
        subtasks: which part of the instruction the bot serves, from which frame on; none if not known.

    Raises:
        UserError: if a field does not have its type, shape or range.
    """

    instruction: str
    grid: np.ndarray
    direction: np.ndarray
    action: np.ndarray
    level: str
    seed: int | None = None
    subtasks: tuple[Subtask, ...] = ()

    def __post_init__(self) -> None:
        check_instruction(self.instruction, "the instruction")
        length = len(self.action)
        if length == 0:
            raise UserError("the episode has no steps")
        check_subtasks(self.subtasks, length, "the subtasks")
        for name, dtype, shape, below in (
            ("grid", np.uint8, (length, GRID_SIZE), 256),
            ("direction", np.uint8, (length,), len(DIRECTIONS)),
            ("action", np.int64, (length,), len(ACTIONS)),
        ):
            values = getattr(self, name)
            if values.shape != shape:
                raise UserError(f"{name} has shape {values.shape} for {length} actions; expected {shape}")
            if values.dtype != dtype:
                raise UserError(f"{name} is {values.dtype}; expected {np.dtype(dtype)}")
            if values.min() < 0 or values.max() >= below:
                raise UserError(f"{name} is outside 0..{below - 1}")
