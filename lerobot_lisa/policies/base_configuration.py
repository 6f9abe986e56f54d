"""Settings that LISA and Lang-DT share: encoders, size, what is learned from a dataset's metadata, optimiser."""

import math
from dataclasses import dataclass, field
from typing import Any

from lerobot.configs import FeatureType, NormalizationMode, PolicyFeature, PreTrainedConfig
from lerobot.optim.optimizers import AdamConfig
from lerobot.optim.schedulers import (
    ConstantWithWarmupSchedulerConfig,
    CosineAnnealingWithWarmupSchedulerConfig,
    LRSchedulerConfig,
)
from lerobot.utils.constants import ACTION, OBS_ENV_STATE

from lerobot_lisa.errors import UserError

WORDS = "words"  # the built-in word-level language encoder
GRID_SYMBOLS = 16  # more than minigrid's 11 objects, 6 colours and 3 door states


@dataclass
class EpisodePolicyConfig(PreTrainedConfig):
    """Shared part of `LisaConfig` and `LangDTConfig`; defaults are the paper's (appendix D) unless a comment says why.

    Attributes:
        width: D, size of every token.
        heads: Attention heads.
        dropout: On residual branches and token embeddings.
        language_encoder: "words", or a Hugging Face id or local path of an encoder.
        freeze_language_encoder: Keep a pretrained encoder as it is; its answers are then cached per instruction.
        image_backbone: A torchvision resnet for image features instead of four convolutions.
        image_backbone_weights: Its weights at the start by torchvision's name, such as "DEFAULT"; None: from scratch.
        ignored_action_dimensions: Dimensions of continuous actions that the environment ignores: they enter no loss.
            Filled in if empty and the dataset's `action` feature names them in its `info`, as {"ignored": ["wrist"]}.
        action_head: For real-valued actions: "mean" (the paper's), "bins" or "mixture" (of Gaussians).
        action_amplification: Factor on the mean of "mean" in rollouts.
        action_bins: For each dimension of "bins".
        action_components: Of "mixture".
        action_temperature: In rollouts categorical actions, bins and mixtures are drawn at this temperature; 0 takes
            the most probable one.
        action_seed: Makes drawing exact: rollout k after training or loading draws from seed `action_seed` + k.
        episode_store: Where whole episodes wait: "memory", "disk" (memory-mapped) or "device" (with the model).
        optimizer_lr: Rate of the parameters that predict actions.
        optimizer_lr_language: Rate of the language encoder; None: the paper's 1e-6 for a pretrained one, `optimizer_lr`
            for "words", which starts from nothing.
        scheduler: "constant" or "cosine" (to zero at the last step), both after a linear warm-up.
        scheduler_warmup_steps: Length of the warm-up.
        language_model: Architecture of the pretrained language encoder; filled in, so that a checkpoint needs no
            download.
        vocabulary: Words of the training instructions; filled in from the dataset, as are the following.
        action_classes: Number of different actions of a categorical action, 0 for real numbers; filled in.
        max_timesteps: Length of the longest training episode; a rollout looks back this far.
    """

    width: int = 128
    heads: int = 4
    dropout: float = 0.1

    language_encoder: str = "distilbert-base-uncased"
    freeze_language_encoder: bool = False
    image_backbone: str | None = None
    image_backbone_weights: str | None = None
    ignored_action_dimensions: list[int] = field(default_factory=list)

    action_head: str = "mean"
    action_amplification: float = 1.0
    action_bins: int = 11
    action_components: int = 5
    # The paper does not say how categorical actions are picked. A policy that always takes the most probable one walks
    # in circles where a demonstrator would not (docs/results.md has both).
    action_temperature: float = 1.0
    action_seed: int = 0

    episode_store: str = "memory"

    optimizer_lr: float = 1e-4
    optimizer_lr_language: float | None = None
    optimizer_betas: tuple[float, float] = (0.9, 0.999)
    optimizer_eps: float = 1e-8
    optimizer_weight_decay: float = 0.0
    optimizer_grad_clip_norm: float = 1.0  # the paper names none; whole episodes give rare large gradients
    scheduler: str = "constant"
    scheduler_warmup_steps: int = 200

    # Observations and actions enter as they are (paper: states are not normalised).
    normalization_mapping: dict[str, NormalizationMode] = field(
        default_factory=lambda: {
            "STATE": NormalizationMode.IDENTITY,
            "ENV": NormalizationMode.IDENTITY,
            "VISUAL": NormalizationMode.IDENTITY,
            "ACTION": NormalizationMode.IDENTITY,
        }
    )

    dtype: str = "float32"  # "bfloat16" trains in mixed precision: LeRobot's accelerator reads this field

    language_model: dict[str, Any] | None = None
    vocabulary: list[str] = field(default_factory=list)
    action_classes: int | None = None
    max_timesteps: int | None = None

    def __post_init__(self) -> None:
        """Refuse settings that cannot work, before anything is loaded."""
        super().__post_init__()
        self._choice("episode_store", ("memory", "disk", "device"))
        self._choice("action_head", ("mean", "bins", "mixture"))
        self._choice("scheduler", ("constant", "cosine"))
        self._choice("dtype", ("float32", "bfloat16", "float16"))
        if self.action_bins < 2 or self.action_components < 1:
            raise UserError("--policy.action_bins must be at least 2 and --policy.action_components at least 1")
        if self.action_temperature < 0:
            raise UserError(f"--policy.action_temperature={self.action_temperature} must be 0 (most probable) or above")
        if self.width < 2 or self.width % 2 or self.width % self.heads:
            raise UserError(
                f"--policy.width={self.width} must be even and a multiple of --policy.heads={self.heads}: "
                "choose e.g. 128 and 4"
            )

    def _choice(self, name: str, choices: tuple[str, ...]) -> None:
        if getattr(self, name) not in choices:
            raise UserError(f"--policy.{name}={getattr(self, name)} is not one of: {', '.join(choices)}")

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
            lr=self.optimizer_lr,
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

    @property
    def language_rate(self) -> float:
        """Learning rate of the language encoder."""
        if self.optimizer_lr_language is not None:
            return self.optimizer_lr_language
        return self.optimizer_lr if self.language_encoder == WORDS else 1e-6

    def describe_dataset(self, features: dict[str, dict[str, Any]], stats: dict[str, Any] | None, longest: int) -> None:
        """Take from a dataset what its `PolicyFeature`s do not say.

        Integer observations become symbols, an integer action becomes categorical, and rollouts will look back as far
        as the longest episode. What the user has set stays.

        Args:
            features: The dataset's `info.json` features.
            stats: Its statistics; tell how many actions there are where `info.json` does not.
            longest: Frames in its longest episode.

        Raises:
            UserError: Symbols or actions are more than the networks have room for, or an ignored action has no name.
        """
        for key, feature in (self.input_features or {}).items():
            if feature.type is FeatureType.STATE and _is_integer(features.get(key, {})):
                _check_symbols(key, stats)
                self.input_features[key] = PolicyFeature(
                    FeatureType.ENV, feature.shape
                )  # out of reach of STATE scaling
            elif key == OBS_ENV_STATE and key in features and not _is_integer(features[key]):
                # LeRobot calls it ENV whatever it holds; as symbols, real numbers would be cut to integers.
                self.input_features[key] = PolicyFeature(FeatureType.STATE, feature.shape)
        if self.action_classes is None:
            self.action_classes = _count_classes(features.get(ACTION, {}), stats)
        _check_classes(self.action_classes, stats)
        if not self.ignored_action_dimensions:
            self.ignored_action_dimensions = _ignored_dimensions(features.get(ACTION, {}))
        if self.max_timesteps is None:
            self.max_timesteps = longest

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
            self._validate_observation(key, feature)
        action = self.action_feature
        if action is None:
            raise UserError(
                f"{self.type} needs a feature called `action`: the dataset has {sorted(self.output_features or {})}"
            )
        if len(action.shape) != 1:
            raise UserError(
                f"{self.type} takes a flat action, but `action` has shape {tuple(action.shape)}: flatten it"
            )
        self._validate_action(action)

    def _validate_observation(self, key: str, feature: PolicyFeature) -> None:
        if feature.type not in (FeatureType.STATE, FeatureType.ENV, FeatureType.VISUAL):
            raise UserError(
                f"{self.type} cannot read `{key}` of type {feature.type.value}: leave it out of --policy.input_features"
            )
        if feature.type is FeatureType.VISUAL and len(feature.shape) != 3:
            raise UserError(f"image `{key}` has shape {tuple(feature.shape)}: it must be (channels, height, width)")
        if math.prod(feature.shape) == 0:
            raise UserError(
                f"`{key}` has the empty shape {tuple(feature.shape)}: leave it out of --policy.input_features"
            )

    def _validate_action(self, action: PolicyFeature) -> None:
        if self.action_classes:
            if action.shape[0] != 1:
                raise UserError(
                    f"a categorical action has shape (1,), this one {tuple(action.shape)}: "
                    "pass --policy.action_classes=0 to treat it as real numbers"
                )
            if self.normalization_mapping.get("ACTION", NormalizationMode.IDENTITY) is not NormalizationMode.IDENTITY:
                raise UserError(
                    "a categorical action cannot be normalised: set normalization_mapping ACTION to IDENTITY"
                )
        outside = [d for d in self.ignored_action_dimensions if not 0 <= d < action.shape[0]]
        if outside or len(set(self.ignored_action_dimensions)) >= action.shape[0]:
            raise UserError(
                f"--policy.ignored_action_dimensions={self.ignored_action_dimensions} must leave at least one of the "
                f"{action.shape[0]} dimensions 0..{action.shape[0] - 1}"
            )
        if self.normalization_mapping.get("ENV", NormalizationMode.IDENTITY) is not NormalizationMode.IDENTITY:
            raise UserError(
                "ENV features hold symbols, which cannot be normalised: set normalization_mapping ENV to IDENTITY"
            )


def _is_integer(feature: dict[str, Any]) -> bool:
    return str(feature.get("dtype", "")).startswith(("int", "uint"))


def _check_symbols(key: str, stats: dict[str, Any] | None) -> None:
    low, high = _range(key, stats) or (0, 0)
    if low < 0 or high >= GRID_SYMBOLS:
        raise UserError(
            f"`{key}` holds integers from {low} to {high}, but symbols are 0..{GRID_SYMBOLS - 1}: "
            "store it as real numbers, or leave it out of --policy.input_features"
        )


def _check_classes(classes: int, stats: dict[str, Any] | None) -> None:
    low, high = _range(ACTION, stats) or (0, 0)
    if classes and (low < 0 or high >= classes):
        raise UserError(
            f"--policy.action_classes={classes} does not fit the dataset, whose actions are {low} to {high}: "
            f"pass {high + 1} or more, or 0 to treat them as real numbers"
        )


def _range(key: str, stats: dict[str, Any] | None) -> tuple[int, int] | None:
    """Least and greatest value of a feature, where the statistics tell."""
    known = (stats or {}).get(key, {})
    return (int(known["min"].min()), int(known["max"].max())) if {"min", "max"} <= known.keys() else None


def _ignored_dimensions(feature: dict[str, Any]) -> list[int]:
    """Dimensions that a dataset names as ignored by its environment."""
    ignored = (feature.get("info") or {}).get("ignored") or []
    names = list(feature.get("names") or [])
    unknown = [name for name in ignored if name not in names]
    if unknown:
        raise UserError(f"the dataset's action says that {unknown} is ignored, but its names are {names}: correct one")
    return [names.index(name) for name in ignored]


def _count_classes(feature: dict[str, Any], stats: dict[str, Any] | None) -> int:
    """Number of different actions; 0 for real-valued ones."""
    if not _is_integer(feature):
        return 0
    names = feature.get("names")
    if isinstance(names, dict) and names.get("classes"):
        return len(names["classes"])
    if stats and "max" in stats.get(ACTION, {}):
        return int(stats[ACTION]["max"].max()) + 1
    raise UserError("the dataset does not say how many different actions there are: pass --policy.action_classes=N")
