"""What uniformly random actions achieve: the floor that every LOReL success rate stands on.

python -m lerobot_lisa.analysis.lorel_random_floor --suite seen --episodes 50

Episodes start as in `lerobot-eval`, which counts its seeds up from 1000.
"""

import argparse
import sys
from collections.abc import Iterator
from itertools import chain

import gymnasium as gym
import numpy as np
from tqdm import tqdm

from lerobot_lisa.analysis.success import success_rate
from lerobot_lisa.envs.lorel.installation import check_installed
from lerobot_lisa.envs.lorel.state import ACTION_HIGH
from lerobot_lisa.envs.lorel.suites import SUITES
from lerobot_lisa.envs.lorel.tasks import Task
from lerobot_lisa.errors import exit_code


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
    parser.add_argument("--arm", choices=("original", "free"), default="original")
    options = parser.parse_args()
    if options.episodes < 1 or options.seed < 0:
        parser.error("--episodes must be at least 1, --seed at least 0")
    return exit_code(lambda: _run(options))


def _run(options: argparse.Namespace) -> None:
    outcomes = [
        random_outcomes(task, task_id, options.episodes, options.seed, options.arm)
        for task_id, task in enumerate(tqdm(SUITES[options.suite], unit="task", disable=None))
    ]
    print("\n".join(_lines(options.suite, outcomes)))


if __name__ == "__main__":
    sys.exit(main())
