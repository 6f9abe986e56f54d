"""LeRobot's `--env.type=metaworld_states`: Meta-World for policies that look at no picture."""

from dataclasses import dataclass, field
from functools import partial
from importlib.util import find_spec
from typing import Any

import gymnasium as gym
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.envs.configs import EnvConfig, MetaworldEnv
from lerobot.processor import PolicyProcessorPipeline
from lerobot.utils.constants import ACTION, OBS_STATE

from lerobot_lisa.envs.metaworld_states.tasks import find_groups
from lerobot_lisa.envs.options import whole_number
from lerobot_lisa.envs.vector import refuse_parallel_tasks, side_by_side
from lerobot_lisa.errors import UserError

_MOST_STEPS = 500  # Meta-World's own limit


def _features() -> dict[str, PolicyFeature]:
    """Those of LeRobot's environment that are no pictures."""
    return {name: shown for name, shown in MetaworldEnv().features.items() if shown.type is not FeatureType.VISUAL}


@EnvConfig.register_subclass("metaworld_states")
@dataclass
class MetaworldStatesConfig(EnvConfig):
    """LeRobot's Meta-World without pictures: hundreds of times as fast where there is no GPU.

    Attributes:
        task: Benchmarks (`MT10`, `MT25`, `MT50`), LeRobot's groups (`easy`, ...) and tasks, separated by commas.
        max_episode_steps: Steps after which an episode ends.
        videos: Whether whoever asks for a picture gets one. `lerobot-eval` asks at every step of ten episodes of each
            task; false: its videos are black, and cost nothing.
    """

    task: str = "reach-v3"
    fps: int = MetaworldEnv.fps
    max_episode_steps: int = _MOST_STEPS
    videos: bool = True
    features: dict[str, PolicyFeature] = field(default_factory=_features)
    features_map: dict[str, str] = field(default_factory=lambda: {"agent_pos": OBS_STATE, ACTION: ACTION})

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """The options that every environment is built with."""
        return {"max_episode_steps": self.max_episode_steps, "videos": self.videos}

    def create_envs(self, n_envs: int, use_async_envs: bool = False) -> dict[str, dict[int, gym.vector.VectorEnv]]:
        """Prepare a vectorised environment for every task, built at its first use.

        Args:
            n_envs: Environments side by side in each.
            use_async_envs: Whether each environment gets a process of its own.

        Returns:
            `{group: {task_id: vectorised environment}}`; a task is a group of its own, as with `--env.type=metaworld`.

        Raises:
            UserError: If MuJoCo or metaworld is missing, a task is unknown, or an option cannot work.
        """
        groups = self._check()
        from lerobot_lisa.envs.metaworld_states.env import MetaworldStatesEnv

        module = MetaworldStatesEnv.__module__
        make = [
            (group, number, [partial(MetaworldStatesEnv, task, **self.gym_kwargs)] * n_envs)
            for group, tasks in groups.items()
            for number, task in enumerate(tasks)
        ]
        envs: dict[str, dict[int, gym.vector.VectorEnv]] = {group: {} for group in groups}
        for group, number, factories in make:
            envs[group][number] = side_by_side(factories, use_async_envs, module)
        return envs

    def get_env_processors(self) -> tuple[PolicyProcessorPipeline, PolicyProcessorPipeline]:
        """LeRobot's hook between environment and policy; training calls it at the start, so names are looked up here.

        Raises:
            UserError: As `create_envs`.
        """
        self._check()
        return super().get_env_processors()

    def _check(self) -> dict[str, list[str]]:
        refuse_parallel_tasks(self)
        whole_number(self.max_episode_steps, 1, _MOST_STEPS, f"env.max_episode_steps is {self.max_episode_steps}")
        for package in ("mujoco", "metaworld"):
            if find_spec(package) is None:
                raise UserError(f'Meta-World needs {package}: pip install "lerobot_policy_lisa[metaworld]"')
        return find_groups(self.task)
