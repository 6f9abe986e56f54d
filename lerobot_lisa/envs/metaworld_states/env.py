"""LeRobot's Meta-World environment that shows where the hand is, and draws nothing unless it is asked for a picture."""

import numpy as np
from gymnasium import spaces

import lerobot_lisa.envs.engine  # noqa: F401  imports MuJoCo, as LeRobot's module would, but chooses before how to draw

from lerobot.envs.metaworld import OBS_DIM, MetaworldEnv  # isort: skip


class MetaworldStatesEnv(MetaworldEnv):
    """The same starts, steps, instructions and successes as LeRobot's, which draws a picture at every step."""

    def __init__(self, task: str, max_episode_steps: int = 500, videos: bool = True) -> None:
        """Prepare; the simulator is built at the first reset."""
        super().__init__(task, obs_type="pixels_agent_pos")
        self.observation_space = spaces.Dict({"agent_pos": spaces.Box(-1000, 1000, (OBS_DIM,), np.float64)})
        self._max_episode_steps, self._videos = max_episode_steps, videos

    def render(self) -> np.ndarray:
        """A picture of what is there, or a small black one (64, 64, 3) where nobody wants to wait for it."""
        return super().render() if self._videos else np.zeros((64, 64, 3), np.uint8)

    def _format_raw_obs(self, raw_obs: np.ndarray) -> dict[str, np.ndarray]:
        return {"agent_pos": raw_obs[:OBS_DIM]}
