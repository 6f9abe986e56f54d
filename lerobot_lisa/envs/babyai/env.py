"""BabyAI as a gymnasium environment that LeRobot can evaluate policies in."""

from math import inf
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from lerobot_lisa.envs.babyai.levels import check_level, make_level, max_steps_bound
from lerobot_lisa.envs.babyai.render import Renderer, default_tile_size
from lerobot_lisa.envs.options import whole_number

Observation = dict[str, np.ndarray]
ACTIONS = ("left", "right", "forward", "pickup", "drop", "toggle", "done")
"""What the actions 0 to 6 do."""


class BabyAIEnv(gym.Env):
    """One BabyAI level.

    Observations hold `grid`, uint8 (147,), the 7x7x3 partial view in C order, and `direction`, uint8 (1,), 0 to 3 for
    right, down, left, up. Every info holds `is_success`, a bool. The environment ends its episodes itself, after
    success, failure or the step limit.

    Attributes:
        task: The level's short name.
        task_description: The instruction of the current episode.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 10}  # noqa: RUF012  (gymnasium's protocol)
    render_mode = "rgb_array"

    def __init__(
        self, task: str = "GoToLocal", max_episode_steps: int | None = None, tile_size: int | None = None
    ) -> None:
        """Build the level.

        Args:
            task: A level's name, such as `GoToLocal` or `BabyAI-GoToLocal-v0`.
            max_episode_steps: Steps after which an episode is cut; None for BabyAI's own limit, new in every episode.
            tile_size: Pixels along each side of a cell in rendered frames, even; None for `default_tile_size`.

        Raises:
            UserError: If there is no such level, or a number is out of range.
        """
        if max_episode_steps is not None:
            max_episode_steps = whole_number(max_episode_steps, 1, inf, f"max_episode_steps is {max_episode_steps!r}")
        self.task = check_level(task)
        self.task_description = ""
        self._level = make_level(task)
        self._started = False
        self._renderer = Renderer(default_tile_size(self._level.width) if tile_size is None else tile_size)
        if max_episode_steps is not None:
            self._level.max_steps, self._level.fixed_max_steps = max_episode_steps, True
        # LeRobot reads this from the first environment only and stops the whole batch there: bound every episode.
        self._max_episode_steps = max_steps_bound(self._level)
        self.action_space = spaces.Discrete(len(ACTIONS))
        self.observation_space = spaces.Dict(
            {"grid": spaces.Box(0, 255, (147,), np.uint8), "direction": spaces.Box(0, 3, (1,), np.uint8)}
        )

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode; the same seed gives the same episode, whatever came before."""
        super().reset(seed=seed)
        self._level.reset(seed=seed)
        self.task_description, self._started = self._level.mission, True
        return self._observation(), {"is_success": False}

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Act once.

        Args:
            action: 0 to 6, as a number or an array of one number, since LeRobot sends float32 (1,).

        Returns:
            Observation, reward (`1 - 0.9 * steps / limit` on success, else 0), terminated, truncated, info. Success on
            the last permitted step is terminated and truncated at once.

        Raises:
            ValueError: If the action is not one number from 0 to 6.
            gymnasium.error.ResetNeeded: If there was no reset, or the environment was closed since.
        """
        self._check_started("step")
        _, reward, terminated, truncated, _ = self._level.step(_action_number(action))
        success = bool(terminated and reward > 0)
        return self._observation(), float(reward), bool(terminated), bool(truncated), {"is_success": success}

    def render(self) -> np.ndarray:
        """Draw the whole world, uint8 (height, width, 3), with what the agent sees highlighted.

        Raises:
            gymnasium.error.ResetNeeded: If there was no reset, or the environment was closed since.
        """
        self._check_started("render")
        return self._renderer.frame(self._level)

    def close(self) -> None:
        """Release the level; a reset starts it again."""
        self._level.close()
        self._started = False

    def _check_started(self, call: str) -> None:
        if not self._started:
            raise gym.error.ResetNeeded(
                f"call reset before {call}: there was none, or the environment was closed since"
            )

    def _observation(self) -> Observation:
        return {
            "grid": self._level.view.image.reshape(-1),
            "direction": np.array([self._level.agent_dir], np.uint8),
        }


def _action_number(action: Any) -> int:
    values = np.asarray(action, np.float64).reshape(-1)
    if values.size != 1 or not -0.5 <= values[0] < len(ACTIONS) - 0.5:
        raise ValueError(f"action is {action!r}: BabyAI takes one number from 0 to {len(ACTIONS) - 1}")
    return round(values[0])
