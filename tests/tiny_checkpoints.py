"""Checkpoints as `lerobot-train` leaves them, made in a second."""

import json
from pathlib import Path
from typing import Any

from lerobot.configs import PreTrainedConfig
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.policies.factory import make_policy, make_pre_post_processors
from lerobot.utils.collate import lerobot_collate_fn

import lerobot_lisa  # noqa: F401  registers the policies
from lerobot_lisa.policies.babyai_rnn.configuration_babyai_rnn import BabyAIRNNConfig
from lerobot_lisa.policies.kmeans_skills.configuration_kmeans_skills import KMeansSkillsConfig
from lerobot_lisa.policies.lang_bc.configuration_lang_bc import LangBCConfig
from lerobot_lisa.policies.lang_dt.configuration_lang_dt import LangDTConfig
from lerobot_lisa.policies.lisa.configuration_lisa import LisaConfig
from lerobot_lisa.policies.lorel_planner.configuration_lorel_planner import LorelPlannerConfig

HORIZON, CODES = 3, 5
SMALL: dict[str, Any] = {
    "dim_model": 32, "n_heads": 2, "language_encoder": "words", "device": "cpu", "push_to_hub": False
}  # fmt: skip


def checkpoint(root: Path, folder: Path, config: PreTrainedConfig) -> Path:
    """A policy whose codebook has seen one batch of the dataset, which its training configuration names."""
    dataset = LeRobotDataset("local/tiny", root=root)
    policy = make_policy(config, ds_meta=dataset.meta)
    pipelines = make_pre_post_processors(config, dataset_stats=dataset.meta.stats)
    policy.train()
    policy.forward(
        pipelines[0](lerobot_collate_fn([dataset[start] for start in dataset.meta.episodes["dataset_from_index"]]))
    )
    for part in (policy, *pipelines):
        part.save_pretrained(folder)
    named = {"dataset": {"repo_id": "local/tiny", "root": str(root), "episodes": None}}
    (folder / "train_config.json").write_text(json.dumps(named))
    return folder


def lisa(root: Path, folder: Path, **settings: Any) -> Path:
    """A LISA checkpoint."""
    sizes = {"horizon": HORIZON, "codebook_size": CODES, "quantizer_warmup_steps": 0}
    return checkpoint(root, folder, LisaConfig(**{**SMALL, **sizes, **settings}))


def lang_dt(root: Path, folder: Path, **settings: Any) -> Path:
    """A Lang-DT checkpoint."""
    return checkpoint(root, folder, LangDTConfig(**{**SMALL, **settings}))


def babyai_rnn(root: Path, folder: Path, **settings: Any) -> Path:
    """A checkpoint of BabyAI's own baseline."""
    return checkpoint(root, folder, BabyAIRNNConfig(**{**SMALL, **settings}))


def lang_bc(root: Path, folder: Path, **settings: Any) -> Path:
    """A checkpoint of language-conditioned behaviour cloning."""
    return checkpoint(root, folder, LangBCConfig(**{**SMALL, **settings}))


def lorel_planner(root: Path, folder: Path, **settings: Any) -> Path:
    """A checkpoint of LOReL's planner, with a short search."""
    search = {"plan_steps": 3, "plan_samples": 20, "plan_elites": 4}
    return checkpoint(root, folder, LorelPlannerConfig(**{**SMALL, **search, **settings}))


def kmeans_skills(root: Path, folder: Path, **settings: Any) -> Path:
    """A checkpoint with skills by k-means."""
    sizes = {"horizon": HORIZON, "codebook_size": CODES}
    return checkpoint(root, folder, KMeansSkillsConfig(**{**SMALL, **sizes, **settings}))
