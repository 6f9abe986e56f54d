"""LeRobot's `--env.type=lorel`: options, features, and the vectorised environments that it evaluates in."""

import logging
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import gymnasium as gym
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.envs.configs import EnvConfig
from lerobot.processor import PolicyProcessorPipeline
from lerobot.utils.constants import ACTION, OBS_IMAGE, OBS_STATE

from lerobot_lisa.envs.known_tasks import KnownTask
from lerobot_lisa.envs.lorel.facts import TellFacts
from lerobot_lisa.envs.lorel.groups import find_groups
from lerobot_lisa.envs.lorel.installation import check_installed
from lerobot_lisa.envs.lorel.observations import shows_pixels, shows_state
from lerobot_lisa.envs.lorel.random_floor import known_task
from lerobot_lisa.envs.lorel.state import ACTION_NAMES, FPS, STATE_NAMES
from lerobot_lisa.envs.lorel.tasks import Task
from lerobot_lisa.envs.vector import refuse_parallel_tasks, side_by_side


def _features_map() -> dict[str, str]:
    return {"agent_pos": OBS_STATE, "pixels": OBS_IMAGE, ACTION: ACTION}


@EnvConfig.register_subclass("lorel")
@dataclass
class LorelEnvConfig(EnvConfig):
    """LOReL's tabletop: suites of instructions, each instruction a task of its own.

    Attributes:
        task: Suites (`seen`, `rephrasals`, `compositions`, `compositions_as_released`) and instructions, separated by
            commas.
        obs_type: What the policy is shown: `state`, `pixels` or `pixels_state`.
        image_quality: How `pixels` are drawn: `minimal`, `smooth` or `full`; the same as in the training data.
        arm: `original`, or `free`: the hand reaches its target, and success rates compare with nobody's.
        render_size: Pixels along each side of videos.
    """

    task: str = "seen"
    fps: int = FPS
    obs_type: str = "state"
    image_quality: str = "minimal"
    arm: str = "original"
    render_size: int = 256
    features: dict[str, PolicyFeature] = field(default_factory=dict)
    features_map: dict[str, str] = field(default_factory=_features_map)

    def __post_init__(self) -> None:
        """Say what there is to see; on every construction, so that a saved configuration reads back the same.

        Values are checked in `create_envs`: the parser of LeRobot's command lines would wrap an error from here.
        """
        self.features = {ACTION: PolicyFeature(type=FeatureType.ACTION, shape=(len(ACTION_NAMES),))}
        if shows_state(self.obs_type):
            self.features["agent_pos"] = PolicyFeature(type=FeatureType.STATE, shape=(len(STATE_NAMES),))
        if shows_pixels(self.obs_type):
            self.features["pixels"] = PolicyFeature(type=FeatureType.VISUAL, shape=(64, 64, 3))

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """The options that every environment is built with."""
        return {
            "obs_type": self.obs_type,
            "image_quality": self.image_quality,
            "arm": self.arm,
            "render_size": self.render_size,
        }

    def create_envs(self, n_envs: int, use_async_envs: bool = False) -> dict[str, dict[int, gym.vector.VectorEnv]]:
        """Prepare a vectorised environment for every task, built at its first use.

        Args:
            n_envs: Environments side by side in each.
            use_async_envs: Whether each environment gets a process of its own.

        Returns:
            `{group: {task_id: vectorised environment}}`, groups as `find_groups` names them.

        Raises:
            UserError: If MuJoCo or metaworld is missing, a task is unknown, an option cannot work, or pictures are
                asked for where nothing can draw them.
        """
        refuse_parallel_tasks(self)
        groups = find_groups(self.task, self.arm)
        if self.arm == "free":
            logging.getLogger(__name__).warning("env.arm is free: an easier world, whose numbers compare with nobody's")
        self._try_out(next(iter(groups.values()))[0])
        module = "lerobot_lisa.envs.lorel.env"
        return {
            group: {i: side_by_side([self._factory(t)] * n_envs, use_async_envs, module) for i, t in enumerate(tasks)}
            for group, tasks in groups.items()
        }

    def get_env_processors(self) -> tuple[PolicyProcessorPipeline, PolicyProcessorPipeline]:
        """LeRobot's hook between environment and policy: tells the policy what it is shown.

        Training calls it at the start, `create_envs` hours later, so names are looked up here, too.

        Raises:
            UserError: A task is unknown, or tasks are to be evaluated at the same time.
        """
        refuse_parallel_tasks(self)
        find_groups(self.task, self.arm)
        facts = TellFacts(self.arm, self.image_quality if shows_pixels(self.obs_type) else None)
        return PolicyProcessorPipeline(steps=[facts]), PolicyProcessorPipeline(steps=[])

    @staticmethod
    def known_task(group: str, task_id: int) -> KnownTask | None:
        """What is known of a task: see `lerobot_lisa.envs.known_tasks`."""
        return known_task(group, task_id)

    def _factory(self, task: Task) -> partial:
        from lerobot_lisa.envs.lorel.env import LorelEnv

        return partial(LorelEnv, task=task, **self.gym_kwargs)

    def _try_out(self, task: Task) -> None:
        """Build and reset one environment, so that mistakes show here and not in a process."""
        check_installed()
        env = self._factory(task)()
        try:
            env.reset(seed=0)
        finally:
            env.close()
