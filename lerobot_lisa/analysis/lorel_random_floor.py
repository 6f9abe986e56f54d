"""What uniformly random actions achieve: the floor that every LOReL success rate stands on.

python -m lerobot_lisa.analysis.lorel_random_floor --suite=seen --n_episodes=50

Episodes start as in `lerobot-eval`, which counts its seeds up from 1000. The floor of every task ships with the suites
and stands beside their numbers in every analysis; this measures it anew:

python -m lerobot_lisa.analysis.lorel_random_floor --table=random_floor.json --n_episodes=1000
"""

import json
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

import gymnasium as gym
import numpy as np
from tqdm import tqdm

from lerobot_lisa.analysis.commands import check_number, run_command
from lerobot_lisa.analysis.success.rates import success_rate
from lerobot_lisa.envs.lorel.installation import check_installed
from lerobot_lisa.envs.lorel.random_floor import floor_key
from lerobot_lisa.envs.lorel.state import ACTION_HIGH
from lerobot_lisa.envs.lorel.suites import SUITES
from lerobot_lisa.envs.lorel.tasks import Task
from lerobot_lisa.errors import UserError

_ROBOT_ARMS = ("original", "free")


@dataclass
class FloorConfig:
    """What to measure."""

    suite: str = "seen"
    """Suite of tasks."""

    n_episodes: int = 50
    """Episodes of each task."""

    seed: int = 1000
    """Of the first episode of each task; the others count up."""

    arm: str = "original"
    """Variant of the simulated robot arm."""

    table: Path | None = None
    """Write the floor of every task of every suite, with both arms, to this file instead."""

    def __post_init__(self) -> None:
        """Refuse what cannot work."""
        if self.suite not in SUITES or self.arm not in _ROBOT_ARMS:
            raise UserError(f"choose --suite from {', '.join(SUITES)}, and --arm from {', '.join(_ROBOT_ARMS)}")
        check_number("n_episodes", self.n_episodes, 1, 1_000_000)
        check_number("seed", self.seed, 0, 2**32 - self.n_episodes)


def random_outcomes(task: Task, task_id: int, episodes: int, seed: int = 1000, arm: str = "original") -> list[bool]:
    """Success of episodes under actions drawn uniformly from the action space.

    Args:
        task: The task.
        task_id: Its place in its suite: tasks share the seeds of their episodes, but not their actions.
        episodes: How many.
        seed: Seed of the first episode; the others count up.
        arm: `original` or `free`.

    Raises:
        UserError: If MuJoCo or metaworld is not installed.
    """
    check_installed()
    from lerobot_lisa.envs.lorel.env import LorelEnv

    env = LorelEnv(task, arm=arm)
    return [_episode(env, first, task_id) for first in range(seed, seed + episodes)]


def _episode(env: gym.Env, seed: int, task_id: int) -> bool:
    rng, high = np.random.default_rng((seed, task_id)), np.array(ACTION_HIGH)
    _, info = env.reset(seed=seed)
    ended = False
    while not ended:
        _, _, terminated, truncated, info = env.step(rng.uniform(-high, high))
        ended = terminated or truncated
    return info["is_success"]


def _lines(suite: str, outcomes: list[list[bool]]) -> Iterator[str]:
    """A line for each task, each kind of instruction and the whole suite, where every task counts the same."""
    tasks = SUITES[suite]
    for task, listed in zip(tasks, outcomes, strict=True):
        yield f"{success_rate(listed)}  {task.instruction}"
    kinds = dict.fromkeys(task.kind for task in tasks)
    for kind in kinds if len(kinds) > 1 else ():
        of_kind = [listed for task, listed in zip(tasks, outcomes, strict=True) if task.kind == kind]
        yield f"{success_rate(chain(*of_kind))}  all {kind}"
    yield f"{success_rate(chain(*outcomes))}  all {suite}"


def main() -> int:
    """Command line; returns the exit code."""
    return run_command(run, interrupted="interrupted")


def run(config: FloorConfig) -> None:
    """Measure, and print or write."""
    if config.table:
        config.table.write_text(json.dumps(_measure_all(config), indent=2) + "\n", encoding="utf-8")
        return
    outcomes = [
        random_outcomes(task, task_id, config.n_episodes, config.seed, config.arm)
        for task_id, task in enumerate(tqdm(SUITES[config.suite], unit="task", disable=None))
    ]
    print("\n".join(_lines(config.suite, outcomes)))


def _measure_all(config: FloorConfig) -> dict[str, object]:
    """Tasks that random actions cannot tell apart are measured once."""
    from lerobot_lisa.envs.lorel.scene import engine

    tasks: dict[str, Task] = {}
    for task in chain(*SUITES.values()):
        tasks.setdefault(floor_key(task), task)
    successes = {
        arm: {
            key: sum(random_outcomes(task, number, config.n_episodes, config.seed, arm))
            for number, (key, task) in enumerate(tqdm(tasks.items(), unit="task", desc=arm, disable=None))
        }
        for arm in _ROBOT_ARMS
    }
    return {
        "episodes": config.n_episodes, "first_seed": config.seed, "engine": engine(), "successes": successes
    }  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
