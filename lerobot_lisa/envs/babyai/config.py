"""LeRobot's `--env.type=babyai`: options, features, and the vectorised environments that it evaluates in."""

from dataclasses import dataclass, field
from functools import partial
from multiprocessing import get_context
from typing import Any

import gymnasium as gym
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.envs.configs import EnvConfig
from lerobot.envs.utils import _LazyAsyncVectorEnv, freeze_after_episode_end
from lerobot.utils.constants import ACTION, OBS_STR

from lerobot_lisa.errors import UserError


def _features() -> dict[str, PolicyFeature]:
    """Describe the data; ENV, not STATE, so that no normaliser touches the symbols."""
    return {
        "grid": PolicyFeature(type=FeatureType.ENV, shape=(147,)),
        "direction": PolicyFeature(type=FeatureType.ENV, shape=(1,)),
        ACTION: PolicyFeature(type=FeatureType.ACTION, shape=(1,)),
    }


def _features_map() -> dict[str, str]:
    return {"grid": f"{OBS_STR}.grid", "direction": f"{OBS_STR}.direction", ACTION: ACTION}


@EnvConfig.register_subclass("babyai")
@dataclass
class BabyAIEnvConfig(EnvConfig):
    """BabyAI levels as one suite; each level is a task of its own.

    Attributes:
        task: A level, or several separated by commas.
        max_episode_steps: Steps after which an episode is cut; None for BabyAI's own limit, new in every episode.
        tile_size: Pixels along each side of a cell in videos, even; None for 16 in a single room and 8 in a maze.
    """

    task: str = "GoToLocal"
    fps: int = 10
    max_episode_steps: int | None = None
    tile_size: int | None = None
    features: dict[str, PolicyFeature] = field(default_factory=_features)
    features_map: dict[str, str] = field(default_factory=_features_map)

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """The options that every environment is built with."""
        return {"max_episode_steps": self.max_episode_steps, "tile_size": self.tile_size}

    def create_envs(self, n_envs: int, use_async_envs: bool = False) -> dict[str, dict[int, gym.vector.VectorEnv]]:
        """Build a vectorised environment for every level.

        Args:
            n_envs: Environments side by side in each.
            use_async_envs: Whether each environment gets a process of its own, started at the first use.

        Returns:
            `{"babyai": {task_id: vectorised environment}}`, in the order of `task`.

        Raises:
            UserError: If minigrid is missing, a level is unknown or an option cannot work.
        """
        if self.max_parallel_tasks > 1:
            raise UserError(
                f"env.max_parallel_tasks is {self.max_parallel_tasks}: LeRobot would run the levels on one policy at "
                "the same time and mix up their histories; leave it at 1"
            )
        vectorise = _in_processes if use_async_envs and n_envs > 1 else _in_turn
        return {"babyai": {i: vectorise(self._factory(level), n_envs) for i, level in enumerate(self._levels())}}

    def _levels(self) -> list[str]:
        levels = [name.strip() for name in self.task.split(",") if name.strip()]
        if not levels:
            raise UserError("env.task is empty: name a BabyAI level, or several separated by commas")
        return levels

    def _factory(self, level: str) -> partial:
        """Prepare to build one environment; builds one on trial, so that mistakes show here and not in a process."""
        try:
            from lerobot_lisa.envs.babyai.env import BabyAIEnv
        except ModuleNotFoundError as error:
            if error.name != "minigrid":
                raise
            raise UserError("BabyAI needs minigrid: pip install lerobot_policy_lisa[babyai]") from None
        factory = partial(BabyAIEnv, task=level, **self.gym_kwargs)
        factory().close()
        return factory


# LeRobot counts one step after an episode's end. With NEXT_STEP and frozen environments that step repeats the end;
# with SAME_STEP, LeRobot's default, it would belong to the next episode, whose success would count.


def _in_turn(factory: partial, n_envs: int) -> gym.vector.VectorEnv:
    factories = [freeze_after_episode_end(factory)] * n_envs
    return gym.vector.SyncVectorEnv(factories, autoreset_mode=gym.vector.AutoresetMode.NEXT_STEP)


def _in_processes(factory: partial, n_envs: int) -> gym.vector.VectorEnv:
    """Leave the start of the processes to the first use: LeRobot's wrapper, which also freezes as above."""
    # Importing LeRobot takes seconds: once in the server that all processes are forked from, not in each of them.
    get_context("forkserver").set_forkserver_preload(["__main__", "lerobot_lisa.envs.babyai.env"])
    return _LazyAsyncVectorEnv([factory] * n_envs)
