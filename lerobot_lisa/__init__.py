"""LISA and Lang-DT as LeRobot policies, BabyAI and LOReL as LeRobot environments: importing this registers them."""

from lerobot_lisa.envs.babyai import BabyAIEnvConfig
from lerobot_lisa.envs.lorel import LorelEnvConfig
from lerobot_lisa.envs.metaworld_states import MetaworldStatesConfig
from lerobot_lisa.policies import base_processor as _base_processor  # noqa: F401  registers the processor step
from lerobot_lisa.policies.lang_dt.configuration_lang_dt import LangDTConfig
from lerobot_lisa.policies.lisa.configuration_lisa import LisaConfig

__all__ = ["BabyAIEnvConfig", "LangDTConfig", "LisaConfig", "LorelEnvConfig", "MetaworldStatesConfig"]
