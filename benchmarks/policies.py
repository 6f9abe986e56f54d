"""Policies and batches as `lerobot-train` makes them, for the parts that measure a model alone."""

import argparse
from typing import Any

import numpy as np
import torch
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.datasets.sampler import EpisodeAwareSampler
from lerobot.policies.factory import make_policy, make_pre_post_processors

from lerobot_lisa.policies.base_modeling import EpisodePolicy
from lerobot_lisa.policies.lang_dt.configuration_lang_dt import LangDTConfig
from lerobot_lisa.policies.lisa.configuration_lisa import LisaConfig

NAMES = {"lisa": "LISA", "lang_dt": "Lang-DT"}
CONFIGS = {"lisa": LisaConfig, "lang_dt": LangDTConfig}
AS_IN_THE_PAPER = {"ask_observations": False, "copy_words": False, "augment": False}
BATCH_SIZE = 128  # the paper's
DRAWS = 21


class Training:
    """A policy of the paper's size with a word-level language encoder, its dataset and its optimiser.

    `settings` are further ones of the policy's; `AS_IN_THE_PAPER` leaves out what the paper's networks do not have.
    """

    def __init__(self, kind: str, options: argparse.Namespace, **settings: Any) -> None:
        self.dataset = LeRobotDataset(options.repo_id, root=options.root)
        torch.manual_seed(0)
        given = {"quantizer_warmup_steps": 0, **settings} if kind == "lisa" else settings
        given = {name: value for name, value in given.items() if hasattr(CONFIGS[kind], name)}
        config = CONFIGS[kind](language_encoder="words", device="cpu", push_to_hub=False, **given)
        self.policy: EpisodePolicy = make_policy(config, ds_meta=self.dataset.meta)
        self.preprocessor, self.postprocessor = make_pre_post_processors(config, dataset_stats=self.dataset.meta.stats)
        self.policy.train()

    def batch(self, size: int = BATCH_SIZE) -> dict[str, Any]:
        """Of the first batches that `lerobot-train` draws with seed 0, the one with the median number of frames."""
        starts, stops = (np.asarray(self.dataset.meta.episodes[f"dataset_{end}_index"]) for end in ("from", "to"))
        frames = iter(EpisodeAwareSampler(starts, stops, shuffle=True, seed=0))
        draws = [[next(frames) for _ in range(size)] for _ in range(DRAWS)]
        totals = [(stops - starts)[np.searchsorted(stops, draw, side="right")].sum() for draw in draws]
        chosen = draws[np.argsort(totals)[DRAWS // 2]]
        return self.preprocessor(torch.utils.data.default_collate([self.dataset[i] for i in chosen]))

    def lengths(self, batch: dict[str, Any]) -> torch.Tensor:
        """Frames of each episode of a batch."""
        store = self.policy.episode_store
        return store.lengths[store.holding(batch["index"])]

    def optimizer(self) -> torch.optim.Optimizer:
        """As configured."""
        return self.policy.config.get_optimizer_preset().build(self.policy.get_optim_params())


def step(parameters: list[torch.nn.Parameter], optimizer: torch.optim.Optimizer, loss: torch.Tensor) -> None:
    """What `lerobot-train` does with a loss."""
    loss.backward()
    torch.nn.utils.clip_grad_norm_(parameters, 1.0)
    optimizer.step()
    optimizer.zero_grad()
