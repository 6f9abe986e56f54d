"""Small policies made the way `lerobot-train` makes them."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import torch
from lerobot.configs import PreTrainedConfig
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.policies.factory import make_policy, make_pre_post_processors

import lerobot_lisa  # noqa: F401  registers the policies
from lerobot_lisa.policies.babyai_rnn.configuration_babyai_rnn import BabyAIRNNConfig
from lerobot_lisa.policies.base_configuration import EpisodePolicyConfig
from lerobot_lisa.policies.base_modeling import EpisodePolicy
from lerobot_lisa.policies.kmeans_skills.configuration_kmeans_skills import KMeansSkillsConfig
from lerobot_lisa.policies.lang_bc.configuration_lang_bc import LangBCConfig
from lerobot_lisa.policies.lang_dt.configuration_lang_dt import LangDTConfig
from lerobot_lisa.policies.lisa.configuration_lisa import LisaConfig
from lerobot_lisa.policies.lorel_planner.configuration_lorel_planner import LorelPlannerConfig

CONFIGS = {
    "lisa": LisaConfig,
    "lang_dt": LangDTConfig,
    "babyai_rnn": BabyAIRNNConfig,
    "lang_bc": LangBCConfig,
    "lorel_planner": LorelPlannerConfig,
    "kmeans_skills": KMeansSkillsConfig,
}
SIZES = {
    "lisa": {"codebook_size": 5, "horizon": 3, "quantizer_warmup_steps": 0},
    "kmeans_skills": {"codebook_size": 5, "horizon": 3},
    "lorel_planner": {"plan_steps": 3, "plan_samples": 20, "plan_elites": 4},
}
SMALL = {"dim_model": 32, "n_heads": 2, "device": "cpu", "push_to_hub": False}


def config(kind: str, **settings: Any) -> EpisodePolicyConfig:
    """A small configuration with the built-in language encoder, unless told otherwise."""
    sizes = SIZES.get(kind, {})
    return CONFIGS[kind](**{"language_encoder": "words", **SMALL, **sizes, **settings})


class Training:
    """A policy, its pipelines and its dataset."""

    def __init__(self, cfg: PreTrainedConfig, root: Path) -> None:
        self.dataset = LeRobotDataset("local/tiny", root=root)
        torch.manual_seed(0)
        self.policy: EpisodePolicy = make_policy(cfg, ds_meta=self.dataset.meta)
        self.preprocessor, self.postprocessor = make_pre_post_processors(
            policy_cfg=cfg, dataset_stats=self.dataset.meta.stats
        )

    def batch(self, frames: Iterable[int]) -> dict[str, Any]:
        """What `forward` gets for some frames."""
        return self.preprocessor(torch.utils.data.default_collate([self.dataset[i] for i in frames]))

    def first_frames(self, episodes: Iterable[int] | None = None) -> list[int]:
        """One frame of each episode."""
        starts = list(self.dataset.meta.episodes["dataset_from_index"])
        return starts if episodes is None else [starts[i] for i in episodes]

    def warm_up(self, steps: int = 2) -> "Training":
        """Let the codebook see data."""
        self.policy.train()
        for _ in range(steps):
            self.policy.forward(self.batch(self.first_frames()))
        return self


def training(kind: str, root: Path, **settings: Any) -> Training:
    """A new small policy for a dataset."""
    return Training(config(kind, **settings), root)
