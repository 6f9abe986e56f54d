"""LISA, Lang-DT and the original baselines as policies, BabyAI and LOReL as environments: importing registers them."""

from lerobot_lisa.envs.babyai import BabyAIEnvConfig
from lerobot_lisa.envs.lorel import LorelEnvConfig
from lerobot_lisa.envs.metaworld_states import MetaworldStatesConfig
from lerobot_lisa.policies import base_processor as _base_processor  # noqa: F401  registers the processor step
from lerobot_lisa.policies.babyai_rnn.configuration_babyai_rnn import BabyAIRNNConfig
from lerobot_lisa.policies.kmeans_skills.configuration_kmeans_skills import KMeansSkillsConfig
from lerobot_lisa.policies.lang_bc.configuration_lang_bc import LangBCConfig
from lerobot_lisa.policies.lang_dt.configuration_lang_dt import LangDTConfig
from lerobot_lisa.policies.lisa.configuration_lisa import LisaConfig
from lerobot_lisa.policies.lorel_planner.configuration_lorel_planner import LorelPlannerConfig

__all__ = [
    "BabyAIEnvConfig",
    "BabyAIRNNConfig",
    "KMeansSkillsConfig",
    "LangBCConfig",
    "LangDTConfig",
    "LisaConfig",
    "LorelEnvConfig",
    "LorelPlannerConfig",
    "MetaworldStatesConfig",
]
