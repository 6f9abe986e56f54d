"""LeRobot's `--env.type=babyai`: options, features, and the vectorised environments that it evaluates in."""

from dataclasses import dataclass, field
from functools import partial
from typing import Any

import gymnasium as gym
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.envs.configs import EnvConfig
from lerobot.processor import PolicyProcessorPipeline
from lerobot.utils.constants import ACTION, OBS_STR

from lerobot_lisa.envs.options import names_in
from lerobot_lisa.envs.vector import refuse_parallel_tasks, side_by_side
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
    def levels(self) -> list[str]:
        """Names in `task`, by task id."""
        return names_in(self.task, "a BabyAI level")

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
        module = "lerobot_lisa.envs.babyai.env"
        factories = enumerate(self._factories())
        return {"babyai": {i: side_by_side([f] * n_envs, use_async_envs, module) for i, f in factories}}

    def get_env_processors(self) -> tuple[PolicyProcessorPipeline, PolicyProcessorPipeline]:
        """LeRobot's hook between environment and policy; training calls it at the start, `create_envs` hours later.

        Raises:
            UserError: As `create_envs`.
        """
        self._factories()
        return super().get_env_processors()

    def _factories(self) -> list[partial]:
        refuse_parallel_tasks(self)
        return [self._factory(level) for level in self.levels]

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
