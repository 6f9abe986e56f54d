"""BabyAI as a LeRobot environment; importing this registers its options only, minigrid waits for the first use."""

from lerobot_lisa.envs.babyai.config import BabyAIEnvConfig

__all__ = ["BabyAIEnvConfig"]
