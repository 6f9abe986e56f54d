"""LISA and Lang-DT as LeRobot policies, BabyAI and LOReL as LeRobot environments: importing this registers them."""

from lerobot_lisa.envs.babyai import BabyAIEnvConfig
from lerobot_lisa.envs.lorel import LorelEnvConfig
from lerobot_lisa.errors import show_user_errors_in_one_line
from lerobot_lisa.policies import instructions as _instructions  # noqa: F401  registers the processor step
from lerobot_lisa.policies.lang_dt.configuration_lang_dt import LangDTConfig
from lerobot_lisa.policies.lisa.configuration_lisa import LisaConfig

__all__ = ["BabyAIEnvConfig", "LangDTConfig", "LisaConfig", "LorelEnvConfig"]

show_user_errors_in_one_line()
