"""Environments side by side, as LeRobot evaluates in them: in turn or in processes, frozen after an episode's end.

LeRobot counts one step after an episode's end. With NEXT_STEP and frozen environments that step repeats the end; with
SAME_STEP, LeRobot's default, it would belong to the next episode, whose success would count.
"""

from collections.abc import Callable, Sequence
from multiprocessing import get_context
from typing import Any

import gymnasium as gym
from lerobot.envs.configs import EnvConfig
from lerobot.envs.utils import _LazyAsyncVectorEnv, freeze_after_episode_end

from lerobot_lisa.errors import UserError

Factories = Sequence[Callable[[], gym.Env]]


def refuse_parallel_tasks(config: EnvConfig) -> None:
    """Raise `UserError` if tasks are to be evaluated at the same time, in threads."""
    if config.max_parallel_tasks > 1:
        raise UserError(
            f"env.max_parallel_tasks is {config.max_parallel_tasks}: LeRobot would run the tasks on one policy at the "
            "same time and mix up their histories; leave it at 1"
        )


def side_by_side(factories: Factories, use_async_envs: bool, module: str) -> gym.vector.VectorEnv:
    """Prepare a vectorised environment; simulators and processes wait for the first use.

    Args:
        factories: What builds each environment.
        use_async_envs: Whether each environment gets a process of its own.
        module: What the processes import, once for all of them, since importing LeRobot takes seconds.
    """
    if not use_async_envs or len(factories) == 1:
        return InTurn(factories)
    get_context("forkserver").set_forkserver_preload(["__main__", module])
    return _LazyAsyncVectorEnv(list(factories))  # freezes them, too


class InTurn(gym.vector.SyncVectorEnv):
    """Environments in one process. LeRobot closes them after every evaluation, and may reset them for another."""

    def __init__(self, factories: Factories) -> None:
        frozen = [freeze_after_episode_end(factory) for factory in factories]
        super().__init__(frozen, autoreset_mode=gym.vector.AutoresetMode.NEXT_STEP)

    def close(self, **kwargs: Any) -> None:
        """Release the simulators, and be ready for the next evaluation."""
        super().close(**kwargs)
        self.closed = False
