"""What listening is measured against in BabyAI: another instruction for a world, and the demonstrator's steps."""

from functools import cache
from typing import Any

from minigrid.envs.babyai.core.roomgrid_level import RejectSampling

from dataset_converters.babyai.bot import demonstrate
from lerobot_lisa.envs.babyai.levels import FastLevel, make_level

TRIES = 200
_STRIDE, _SEEDS = 7_919, 1_000_000  # seeds of training begin at the latter

_level = cache(make_level)  # every use resets it
_source = cache(make_level)


def another_mission(name: str, seed: int) -> str | None:
    """What the level's world of this seed could ask for instead; None if nothing was found."""
    level = _level(name)
    level.reset(seed=seed)
    instruction = another_instruction(level, _source(name), seed)
    return None if instruction is None else instruction.surface(level)


def another_instruction(level: FastLevel, source: FastLevel, seed: int) -> Any:
    """The instruction of another episode that says something else and can be carried out in this world.

    Args:
        level: A world of this seed, just reset.
        source: The same level, where other episodes are looked at.
        seed: Chooses among them.

    Returns:
        minigrid's instruction, or None if none of `TRIES` episodes has one.
    """
    for number in range(1, TRIES + 1):
        source.reset(seed=(seed + number * _STRIDE) % _SEEDS)
        instruction = source.instrs
        try:
            if instruction.surface(level) != level.mission:
                level.validate_instrs(instruction)
                return instruction
        except (AssertionError, RejectSampling):  # an object is not here; a put-next that is done or cannot be
            continue
    return None


def demonstrator_steps(name: str, seed: int) -> int | None:
    """How many steps BabyAI's bot needs in the level's world of this seed; None if it fails."""
    demonstration = demonstrate(_level(name), name, seed)
    return None if demonstration is None else len(demonstration.action)
