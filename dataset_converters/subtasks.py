"""Subtasks: what is being done in an episode from which frame on. No LeRobot here: the bot's processes need none."""

from collections.abc import Iterator, Sequence
from itertools import groupby
from typing import NamedTuple

from dataset_converters.instructions import check_instruction
from lerobot_lisa.errors import UserError


class Subtask(NamedTuple):
    """What is done from a frame of an episode on, until the next subtask.

    Attributes:
        frame: Its first one, counted within the episode.
        text: Such as "go to the red ball".
    """

    frame: int
    text: str


def changes(texts: Sequence[str]) -> Iterator[Subtask]:
    """The subtasks of an episode, of which each frame has one."""
    frame = 0
    for text, frames in groupby(texts):
        yield Subtask(frame, text)
        frame += len(list(frames))


def check_subtasks(subtasks: Sequence[Subtask], length: int, where: str) -> None:
    """Raise `UserError`, which begins with `where`, unless subtasks fit an episode of so many frames."""
    frames = [subtask.frame for subtask in subtasks]
    if frames != sorted(set(frames)) or any(not 0 <= frame < length for frame in frames):
        raise UserError(f"{where} begin at frames {frames} of {length}: let them begin one after another, from 0 on")
    for subtask in subtasks:
        check_instruction(subtask.text, f"{where}: the one of frame {subtask.frame}")
