"""Demonstrations by our bot and view against minigrid's own bot in minigrid's own environment."""

import argparse
import contextlib
from functools import partial

import gymnasium as gym
import numpy as np
from minigrid.utils.baby_ai_bot import BabyAIBot

from benchmarks.measuring import contest
from benchmarks.table import Row, ratio_row
from dataset_converters.babyai.bot import demonstrate
from dataset_converters.babyai.demonstration import Demonstration
from lerobot_lisa.envs.babyai.levels import FastLevel, make_level

LEVELS = ("GoToSeq", "SynthSeq", "BossLevel")
EPISODES, FIRST_SEED = 20, 1_000_000


def rows(options: argparse.Namespace) -> list[Row]:
    return [_row(name, options) for name in LEVELS]


def _row(name: str, options: argparse.Namespace) -> Row:
    ours, theirs = make_level(name), minigrids_level(name)
    seeds = range(FIRST_SEED, FIRST_SEED + EPISODES)
    result = contest(
        lambda: sum(1 for seed in seeds if demonstrate(ours, name, seed) or True),
        lambda: sum(1 for seed in seeds if minigrids_demonstration(theirs, name, seed) or True),
        options.repeats,
    )
    details = {"equal episodes": equal_episodes(name, options.check)} if options.check else {}
    return ratio_row(f"demonstrations of {name}", "minigrid's own bot and view", 2.5, result, "episodes", **details)


def equal_episodes(name: str, episodes: int) -> int:
    """Compare demonstrations of the first training seeds with minigrid's, value for value.

    Returns:
        How many were compared: all.

    Raises:
        RuntimeError: One differs.
    """
    level, original = make_level(name), minigrids_level(name)
    for seed in range(FIRST_SEED, FIRST_SEED + episodes):
        ours, theirs = (
            make(name=name, seed=seed)
            for make in (partial(demonstrate, level), partial(minigrids_demonstration, original))
        )
        if not equal(ours, theirs):
            raise RuntimeError(f"{name}, seed {seed}: our demonstration differs from minigrid's")
    return episodes


def equal(ours: Demonstration | None, theirs: Demonstration | None) -> bool:
    """Whether two demonstrations are the same; both may have failed."""
    if ours is None or theirs is None:
        return ours is theirs
    arrays = all(np.array_equal(getattr(ours, key), getattr(theirs, key)) for key in ("grid", "direction", "action"))
    return arrays and ours.instruction == theirs.instruction


def minigrids_level(name: str) -> FastLevel:
    """The environment as minigrid makes it."""
    return gym.make(f"BabyAI-{name}-v0").unwrapped  # type: ignore[return-value]


def minigrids_demonstration(level: FastLevel, name: str, seed: int) -> Demonstration | None:
    """What `demonstrate` makes, with nothing of ours."""
    with contextlib.redirect_stdout(None):  # it prints every world that it rejects
        seen, _ = level.reset(seed=seed)
    bot, over, reward = BabyAIBot(level), False, 0.0
    images, directions, actions = [], [], []
    while not over:
        try:
            action = bot.replan(actions[-1] if actions else None)
        except Exception:
            return None
        images.append(seen["image"].reshape(-1))
        directions.append(seen["direction"])
        actions.append(int(action))
        seen, reward, terminated, truncated, _ = level.step(action)
        over = terminated or truncated
    if not (terminated and reward > 0):
        return None
    frames = np.stack(images), np.array(directions, np.uint8), np.array(actions, np.int64)
    return Demonstration(level.mission, *frames, level=name, seed=seed)
