"""What uniformly random actions achieve: the floor that every LOReL success rate stands on.

python -m lerobot_lisa.analysis.lorel_random_floor --suite seen --episodes 50

Episodes start as in `lerobot-eval`, which counts its seeds up from 1000. The floor of every task ships with the suites
and stands beside their numbers in `lerobot_lisa.analysis.success`; this measures it anew:

python -m lerobot_lisa.analysis.lorel_random_floor --table random_floor.json --episodes 1000
"""

import argparse
import json
import sys
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from tqdm import tqdm

from lerobot_lisa.analysis.success import success_rate
from lerobot_lisa.envs.lorel.installation import check_installed
from lerobot_lisa.envs.lorel.random_floor import floor_key
from lerobot_lisa.envs.lorel.state import ACTION_HIGH
from lerobot_lisa.envs.lorel.suites import SUITES
from lerobot_lisa.envs.lorel.tasks import Task
from lerobot_lisa.errors import UserError, exit_code

_ARMS = ("original", "free")


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
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--suite", choices=list(SUITES), default="seen")
    parser.add_argument("--episodes", type=int, default=50, help="for each task (default: 50)")
    parser.add_argument("--seed", type=int, default=1000, help="of the first episode of each task (default: 1000)")
    parser.add_argument("--arm", choices=_ARMS, default="original")
    parser.add_argument("--table", type=Path, help="write the floor of every task of every suite to this file instead")
    options = parser.parse_args()
    if options.episodes < 1 or options.seed < 0:
        parser.error("--episodes must be at least 1, --seed at least 0")
    return exit_code(lambda: _write_table(options) if options.table else _run(options))


def _run(options: argparse.Namespace) -> None:
    outcomes = [
        random_outcomes(task, task_id, options.episodes, options.seed, options.arm)
        for task_id, task in enumerate(tqdm(SUITES[options.suite], unit="task", disable=None))
    ]
    print("\n".join(_lines(options.suite, outcomes)))


def _write_table(options: argparse.Namespace) -> None:
    """Tasks that random actions cannot tell apart are measured once."""
    tasks: dict[str, Task] = {}
    for task in chain(*SUITES.values()):
        tasks.setdefault(floor_key(task), task)
    successes: dict[str, dict[str, int]] = {}
    for arm in _ARMS:
        successes[arm] = {
            key: sum(random_outcomes(task, number, options.episodes, options.seed, arm))
            for number, (key, task) in enumerate(tqdm(tasks.items(), unit="task", desc=arm, disable=None))
        }
    text = json.dumps(_described(options) | {"successes": successes}, indent=2) + "\n"
    try:
        options.table.write_text(text, encoding="utf-8")
    except OSError as error:
        raise UserError(f"{options.table}: {error.strerror or error}: choose another --table") from error


def _described(options: argparse.Namespace) -> dict[str, Any]:
    from lerobot_lisa.envs.lorel.scene import engine

    return {"episodes": options.episodes, "first_seed": options.seed, "engine": engine()}


if __name__ == "__main__":
    sys.exit(main())
