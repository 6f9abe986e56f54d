"""What the configurations of all policies here do: refuse what cannot work, learn from a dataset, fill in the rest."""

import math
from dataclasses import dataclass, fields
from typing import Any

import draccus
from draccus.parsers.encoding import encode_choice
from lerobot.configs import FeatureType, NormalizationMode, PolicyFeature, PreTrainedConfig
from lerobot.optim.optimizers import AdamConfig
from lerobot.optim.schedulers import (
    ConstantWithWarmupSchedulerConfig,
    CosineAnnealingWithWarmupSchedulerConfig,
    LRSchedulerConfig,
)

from lerobot_lisa.errors import UserError
from lerobot_lisa.policies.accepted_features import (
    check_action,
    check_frozen_backbone,
    check_observation,
    check_symbols,
)
from lerobot_lisa.policies.accepted_settings import check_choice, check_device, check_numbers, check_size
from lerobot_lisa.policies.dataset_features import learn_features
from lerobot_lisa.policies.episode_settings import PAPERS_RATE, SYMBOLS, EpisodeSettings
from lerobot_lisa.policies.old_fields import OldFields


@dataclass
class EpisodePolicyConfig(EpisodeSettings):
    """Base of the policies' configurations; `EpisodeSettings` says what each field means."""

    def __post_init__(self) -> None:
        """Refuse settings that cannot work, before anything is loaded or allocated."""
        check_device(self.device)
        super().__post_init__()
        check_choice(self, "episode_store", ("memory", "disk", "device"))
        check_choice(self, "action_head", ("mean", "bins", "mixture"))
        check_choice(self, "scheduler", ("constant", "cosine"))
        check_choice(self, "dtype", ("float32", "bfloat16", "float16"))
        check_numbers(self)
        check_size(self, self._count_parameters())
        if self.use_amp and self.dtype == "float32":
            self.dtype = "bfloat16"  # which is what LeRobot looks at where a policy has such a field
        if self.excerpt_steps and not self.EXCERPT_STEPS:
            raise UserError(f"--policy.excerpt_steps={self.excerpt_steps}: {self.type} learns from whole episodes only")
        self._is_checkpoint = self.max_timesteps is not None

    def _count_parameters(self) -> int:
        """Roughly, without a pretrained encoder: tables of embeddings and attention blocks, where large numbers go."""
        seen = sum(
            math.prod(feature.shape) * (SYMBOLS if feature.type is FeatureType.ENV else 1)
            for feature in (self.input_features or {}).values()
            if feature.type is not FeatureType.VISUAL
        )
        action = math.prod(self.action_feature.shape) if self.action_feature else 1
        drawn = (self.action_classes or 0) + action * max(self.action_bins, 3 * self.action_components)
        rows = 2 * seen + drawn + len(self.vocabulary) + len(self.lexicon) + (self.max_timesteps or 1)
        layers = sum(getattr(self, f.name) for f in fields(self) if f.name.startswith("n_") and "layers" in f.name)
        return self.dim_model * rows + 12 * self.dim_model**2 * layers

    # Whole episodes come from the episode store, so LeRobot's loader is asked for single frames only.

    @property
    def observation_delta_indices(self) -> None:
        """No windows from LeRobot's loader."""
        return None

    @property
    def action_delta_indices(self) -> None:
        """No windows from LeRobot's loader."""
        return None

    @property
    def reward_delta_indices(self) -> None:
        """No rewards."""
        return None

    def get_optimizer_preset(self) -> AdamConfig:
        """Adam (paper, appendix D); the policies hand it one parameter group per learning rate."""
        return AdamConfig(
            lr=self.policy_rate,  # groups bring their own
            betas=self.optimizer_betas,
            eps=self.optimizer_eps,
            weight_decay=self.optimizer_weight_decay,
            grad_clip_norm=self.optimizer_grad_clip_norm,
        )

    def get_scheduler_preset(self) -> LRSchedulerConfig:
        """One factor for all parameter groups."""
        if self.scheduler == "cosine":
            return CosineAnnealingWithWarmupSchedulerConfig(num_warmup_steps=self.scheduler_warmup_steps)
        return ConstantWithWarmupSchedulerConfig(num_warmup_steps=self.scheduler_warmup_steps)

    def set_dataset_feature_metadata(self, features: dict[str, dict[str, Any]]) -> None:
        """Take from a dataset's `info.json` what its `PolicyFeature`s do not say: a hook that LeRobot's factory calls.

        Raises:
            UserError: An ignored action has no name.
        """
        learn_features(self, features)

    def fill_in(self) -> None:
        """Choose what the user has left open and what depends on the features."""
        if self._is_checkpoint:  # what it does not name did not exist when it was made
            self._fill_in_as_it_was()
        shows_pictures = any(feature.type is FeatureType.VISUAL for feature in (self.input_features or {}).values())
        if self.excerpt_steps is None:
            self.excerpt_steps = self.EXCERPT_STEPS if shows_pictures else 0
        if self.lookback_steps is None:
            self.lookback_steps = self.LOOKBACK_STEPS if shows_pictures else 0
        if self.optimizer_lr is None:
            self.optimizer_lr = 3e-4 if shows_pictures else PAPERS_RATE
        scaled = {"STATE": NormalizationMode.MEAN_STD, "ACTION": NormalizationMode.MEAN_STD}
        if self.action_classes:
            scaled["ACTION"] = NormalizationMode.IDENTITY
        self.normalization_mapping = {**scaled, **self.normalization_mapping}

    def _fill_in_as_it_was(self) -> None:
        """Choose what was done before there was a choice."""
        self.excerpt_steps, self.lookback_steps = self.excerpt_steps or 0, self.lookback_steps or 0

    @property
    def learned_steps(self) -> int:
        """Steps of the parts of episodes that are learned from; 0: whole episodes."""
        return self.excerpt_steps or 0

    @property
    def look_stride(self) -> int:
        """Which of the steps before an excerpt are looked at: every so many."""
        return 1

    def validate_features(self) -> None:
        """Refuse features the networks cannot take.

        Raises:
            UserError: No observation, no action, an unsupported type or shape, or a scaling that would break symbols.
        """
        if not self.input_features:
            raise UserError(
                f"{self.type} needs at least one observation.* feature (grid, state or image): the dataset has none"
            )
        for key, feature in self.input_features.items():
            self._check_observation(key, feature)
        check_symbols(self)
        check_action(self)
        check_frozen_backbone(self)
        check_size(self, self._count_parameters())

    def _check_observation(self, key: str, feature: PolicyFeature) -> None:
        check_observation(self, key, feature)


@draccus.encode.register(EpisodePolicyConfig, include_subclasses=True)
def _encode(config: EpisodePolicyConfig, _: Any = None) -> dict[str, Any]:
    """For `config.json` and `train_config.json`."""
    old = {f.name for f in fields(OldFields)}
    return {key: value for key, value in encode_choice(config, PreTrainedConfig).items() if key not in old}
