"""Worlds that hold two goals at once: the policy is told one of them, and both are watched."""

from collections.abc import Callable, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from lerobot.envs.utils import freeze_after_episode_end
from numpy.typing import NDArray

from lerobot_lisa.analysis.recording.environment import Moment

GOALS = ("original", "other")


class GoalWatcher:
    """Watches a recording of worlds with two goals: which ones each episode has reached, (E, 2), in order."""

    def __init__(self) -> None:
        """Nothing yet."""
        self._reached: list[NDArray[np.bool_]] = []
        self._counting: list[int] = []

    @property
    def reached(self) -> NDArray[np.bool_]:
        """Whether the goals of `GOALS` were reached, (E, 2)."""
        return np.concatenate(self._reached)

    def before_step(self, moment: Moment) -> None:
        """Note which environments count: LeRobot fills up its last batch."""
        if moment.step == 0:
            self._counting = moment.live

    def after_rollout(self, moment: Moment) -> None:
        """Ask the worlds."""
        self._reached.append(np.array(moment.env.call("reached"), bool)[self._counting])


def side_by_side(factories: Sequence[Callable[[], gym.Env]]) -> gym.vector.SyncVectorEnv:
    """Environments in one process, as LeRobot's evaluation wants them: ended episodes stay as they are."""
    frozen: list[Any] = [freeze_after_episode_end(factory) for factory in factories]
    return gym.vector.SyncVectorEnv(frozen, autoreset_mode=gym.vector.AutoresetMode.NEXT_STEP)
