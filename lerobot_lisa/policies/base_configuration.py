"""Settings that LISA and Lang-DT share: encoders, size, what is learned from a dataset's metadata, optimiser."""

from dataclasses import dataclass, field, fields
from typing import Any

import draccus
from draccus.parsers.encoding import encode_choice
from lerobot.configs import NormalizationMode, PreTrainedConfig
from lerobot.optim.optimizers import AdamConfig
from lerobot.optim.schedulers import (
    ConstantWithWarmupSchedulerConfig,
    CosineAnnealingWithWarmupSchedulerConfig,
    LRSchedulerConfig,
)

from lerobot_lisa.errors import UserError
from lerobot_lisa.policies.dataset_facts import note_facts
from lerobot_lisa.policies.feature_checks import check_features
from lerobot_lisa.policies.old_fields import OldFields

WORDS = "words"  # the built-in word-level language encoder


@dataclass
class EpisodePolicyConfig(OldFields, PreTrainedConfig):
    """Shared part of `LisaConfig` and `LangDTConfig`; defaults are the paper's (appendix D) unless a comment says why.

    Attributes:
        dim_model: D, size of every token.
        n_heads: Attention heads.
        dropout: On residual branches and token embeddings.
        language_encoder: "words", or a Hugging Face id or local path of an encoder.
        freeze_language_encoder: Keep a pretrained encoder as it is; its answers are then cached per instruction.
        vision_backbone: A torchvision resnet for image features instead of three convolutions.
        pretrained_backbone_weights: Its weights at the start by torchvision's name, such as "DEFAULT"; None: none.
        ignored_action_dimensions: Dimensions of continuous actions that the environment ignores: they enter no loss.
            None: those that the dataset's `action` feature names in its `info`, as {"ignored": ["wrist"]}.
        feature_info: Facts about the dataset's features that an environment must share, such as how images were drawn;
            filled in from the `info` of its features. An environment that tells other facts is refused, unless None.
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

    dim_model: int = 128
    n_heads: int = 4
    dropout: float = 0.1

    language_encoder: str = "distilbert-base-uncased"
    freeze_language_encoder: bool = False
    vision_backbone: str | None = None
    pretrained_backbone_weights: str | None = None
    ignored_action_dimensions: list[int] | None = None
    feature_info: dict[str, dict[str, Any]] | None = None

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
        if self.dim_model < 2 or self.dim_model % 2 or self.dim_model % self.n_heads:
            raise UserError(
                f"--policy.dim_model={self.dim_model} must be even and a multiple of --policy.n_heads={self.n_heads}: "
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
        note_facts(self, features, stats, longest)

    def validate_features(self) -> None:
        """Refuse features the networks cannot take.

        Raises:
            UserError: No observation, no action, an unsupported type or shape, or a scaling that would break symbols.
        """
        check_features(self)


@draccus.encode.register(EpisodePolicyConfig, include_subclasses=True)
def _encode(config: EpisodePolicyConfig, _: Any = None) -> dict[str, Any]:
    """For `config.json` and `train_config.json`."""
    old = {f.name for f in fields(OldFields)}
    return {key: value for key, value in encode_choice(config, PreTrainedConfig).items() if key not in old}
