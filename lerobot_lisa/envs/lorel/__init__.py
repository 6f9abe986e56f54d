"""LOReL's tabletop as a LeRobot environment; importing registers its options only, MuJoCo waits for the first use."""

from lerobot_lisa.envs.lorel.config import LorelEnvConfig

__all__ = ["LorelEnvConfig"]
