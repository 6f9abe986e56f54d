"""LOReL's tabletop as a gymnasium environment that LeRobot can evaluate policies in."""

import logging
from functools import cache
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from lerobot_lisa.envs.lorel.camera import IMAGE_SIZE, check_quality, check_size, shared_camera
from lerobot_lisa.envs.lorel.observations import check_obs_type, shows_pixels, shows_state
from lerobot_lisa.envs.lorel.scene import check_arm
from lerobot_lisa.envs.lorel.simulator import LorelSimulator
from lerobot_lisa.envs.lorel.state import ACTION_HIGH, STATE_NAMES
from lerobot_lisa.envs.lorel.suites import find_task
from lerobot_lisa.envs.lorel.tasks import Task
from lerobot_lisa.errors import UserError

Observation = dict[str, np.ndarray]

_VIDEO_QUALITY = "minimal"  # whatever the policy is shown: videos are to cost little


class LorelEnv(gym.Env):
    """One task on the tabletop.

    Observations hold, by `obs_type`, `agent_pos`, float32 (15,), named in `state.STATE_NAMES`, and `pixels`, uint8
    (64, 64, 3). An action is float32 (5,), named in `state.ACTION_NAMES`; its fourth number, the wrist, has no effect.
    Every info holds `is_success`, a bool. An episode ends with success or with the last step.

    Attributes:
        task: The instruction.
        task_description: The same; LeRobot reads it.
        state: The 15 numbers that the current observation shows, float32.
    """

    # A step is 12.5 ms: videos show everything eight times slower.
    metadata = {"render_modes": ["rgb_array"], "render_fps": 10}  # noqa: RUF012  (gymnasium's protocol)
    render_mode = "rgb_array"

    def __init__(
        self,
        task: str | Task = "close drawer",
        obs_type: str = "state",
        image_quality: str = "minimal",
        arm: str = "original",
        render_size: int = 256,
    ) -> None:
        """Note what to build: the simulator comes with the first reset, an OpenGL context with the first picture.

        Args:
            task: A task, or an instruction of one of the suites.
            obs_type: `state`, `pixels` or `pixels_state`.
            image_quality: How `pixels` are drawn: `minimal`, `smooth` or `full`.
            arm: `original`, or `free`, whose numbers compare with nobody's.
            render_size: Pixels along each side of frames for videos, 16 to 480.

        Raises:
            UserError: If an argument is out of range, or metaworld is not installed.
        """
        self._task = find_task(task) if isinstance(task, str) else task
        self.task = self.task_description = self._task.instruction
        self._obs_type = check_obs_type(obs_type)
        self._arm, self._image_quality = check_arm(arm), check_quality(image_quality)
        self._render_size = check_size(render_size)
        self._simulator: LorelSimulator | None = None
        self._max_episode_steps = self._task.steps
        self._steps = 0
        self.state = np.zeros(len(STATE_NAMES), np.float32)
        self._first_state = self.state
        high = np.array(ACTION_HIGH, np.float32)
        self.action_space = spaces.Box(-high, high, dtype=np.float32)
        self.observation_space = _observation_space(obs_type)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode, everything at rest; the same seed gives the same episode, whatever came before."""
        super().reset(seed=seed)
        if self._simulator is None:
            self._simulator = LorelSimulator(self._arm)
        self._simulator.reset_for_task(self.np_random, self._task.placement, self._task.hand_target)
        self._steps = 0
        self.state = self._first_state = self._simulator.state.astype(np.float32)
        return self._observation(), {"is_success": False}

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Act once; success is looked for after each step and ends the episode.

        Args:
            action: Five finite numbers; those out of bounds are clipped.

        Returns:
            Observation, reward (1 on success, else 0), terminated (success), truncated (no step left), info.

        Raises:
            ValueError: If the action is not five finite numbers.
            gymnasium.error.ResetNeeded: If there was no reset, or the environment was closed since.
        """
        simulator = self._started("step")
        simulator.step(action)
        self._steps += 1
        self.state = simulator.state.astype(np.float32)
        success = self._task.succeeded(self._first_state, self.state)
        return self._observation(), float(success), success, self._steps >= self._task.steps, {"is_success": success}

    def render(self) -> np.ndarray:
        """Draw what the camera sees, at a size for people, uint8 (render_size, render_size, 3).

        LeRobot always asks for some. They are black if this machine cannot draw, unless the policy needs pictures.

        Raises:
            UserError: If this machine cannot draw and the policy needs pictures.
            gymnasium.error.ResetNeeded: As in `step`.
        """
        self._started("render")
        try:
            return shared_camera(_VIDEO_QUALITY, self._render_size, self._arm).frame(self.state)
        except UserError as error:
            if shows_pixels(self._obs_type):
                raise
            _warn_once(str(error))
            return np.zeros((self._render_size, self._render_size, 3), np.uint8)

    def close(self) -> None:
        """Release the simulator; a reset builds it again."""
        self._simulator = None

    def _started(self, call: str) -> LorelSimulator:
        if self._simulator is None:
            raise gym.error.ResetNeeded(
                f"call reset before {call}: there was none, or the environment was closed since"
            )
        return self._simulator

    def _observation(self) -> Observation:
        observation = {}
        if shows_state(self._obs_type):
            observation["agent_pos"] = self.state.copy()
        if shows_pixels(self._obs_type):
            observation["pixels"] = shared_camera(self._image_quality, IMAGE_SIZE, self._arm).frame(self.state)
        return observation


def _observation_space(obs_type: str) -> spaces.Dict:
    members: dict[str, spaces.Space] = {}
    if shows_state(obs_type):
        members["agent_pos"] = spaces.Box(-np.inf, np.inf, (len(STATE_NAMES),), np.float32)
    if shows_pixels(obs_type):
        members["pixels"] = spaces.Box(0, 255, (IMAGE_SIZE, IMAGE_SIZE, 3), np.uint8)
    return spaces.Dict(members)


@cache
def _warn_once(reason: str) -> None:
    logging.getLogger(__name__).warning("Videos are black: %s", reason)
