"""LeRobot's Meta-World for policies that look at no picture: the same world, without drawing it."""

from lerobot_lisa.envs.metaworld_states.config import MetaworldStatesConfig

__all__ = ["MetaworldStatesConfig"]
