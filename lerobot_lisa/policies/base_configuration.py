"""Settings that LISA and Lang-DT share, what they learn from a dataset's metadata, and which of all that is refused."""

import logging
import math
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar

import draccus
import torch
from draccus.parsers.encoding import encode_choice
from lerobot.configs import FeatureType, NormalizationMode, PolicyFeature, PreTrainedConfig
from lerobot.optim.optimizers import AdamConfig
from lerobot.optim.schedulers import (
    ConstantWithWarmupSchedulerConfig,
    CosineAnnealingWithWarmupSchedulerConfig,
    LRSchedulerConfig,
)
from lerobot.transforms import ImageTransformsConfig
from lerobot.utils.constants import ACTION, OBS_ENV_STATE

from lerobot_lisa.errors import UserError
from lerobot_lisa.feature_info import feature_info
from lerobot_lisa.policies.old_fields import OldFields

WORDS = "words"  # the built-in word-level language encoder
SYMBOLS = 16  # more than minigrid's 11 objects, 6 colours and 3 door states
PAPERS_RATE = 1e-4
DEVICES = ("cpu", "cuda", "mps", "xpu")
MOST_PARAMETERS = 500_000_000  # 2 GB; the paper's networks have a million. A config.json may come from anybody


@dataclass
class EpisodePolicyConfig(OldFields, PreTrainedConfig):
    """Shared part of `LisaConfig` and `LangDTConfig`; defaults are the paper's (appendix D) unless a comment says why.

    Attributes:
        dim_model: D, size of every token.
        n_heads: Attention heads.
        dropout: On residual branches and token embeddings.
        language_encoder: "words", or a Hugging Face id or local path of an encoder.
        freeze_language_encoder: Keep a pretrained encoder as it is; its answers are then cached per instruction.
        vision_backbone: A torchvision resnet, or a Hugging Face id or local path of a vision model (DINOv2, SigLIP,
            CLIP), instead of three convolutions.
        pretrained_backbone_weights: A resnet's weights at the start by torchvision's name, such as "DEFAULT"; None:
            none.
        freeze_vision_backbone: Keep it as it is; it is asked once for each frame, and its answers are kept beside the
            episode store: from then on a picture costs what a state costs.
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
        numbers: Integer observations that are quantities, such as the ticks of an encoder, and no symbols. None: those
            that hold others than 0 to 15.
        episode_store: Where whole episodes wait: "memory", "disk" (memory-mapped) or "device" (with the model).
        image_size: Pixels of the longer side of pictures; larger ones are made smaller, once for training and in
            rollouts alike. None: as they come.
        excerpt_steps: What a training step learns from of the episode of a drawn frame: the part of this many steps
            that holds it (see `networks.excerpts.cut`), so that a step costs the same at any length. LISA's are whole
            chunks. 0: the whole episode, as in the paper. None: `EXCERPT_STEPS` if there are pictures, else 0.
        lookback_steps: How far each block of the transformers over episodes looks back, in training and in rollouts. 0:
            over the longest training episode. None: `LOOKBACK_STEPS` if there are pictures, else 0.
        optimizer_lr: Rate of the parameters that predict actions. None: the paper's 1e-4; with pictures 3e-4, since
            what sees them starts from nothing.
        optimizer_lr_language: Rate of the language encoder; None: the paper's 1e-6 for a pretrained one, `optimizer_lr`
            for "words", which starts from nothing.
        scheduler: "constant" or "cosine" (to zero at the last step), both after a linear warm-up.
        scheduler_warmup_steps: Length of the warm-up.
        ask_observations: Words and skill codes ask the parts of what is seen, such as a grid's cells or a picture's
            patches, by name where symbols have names. The paper's networks see every frame as one vector: false.
        names: Where a dataset names its symbols, things are asked for by what they are called, and LISA copies a name
            first. False, an ablation: what to ask cells by is learned, and any phrase may be copied.
        augment: Train on changed episodes where a dataset names its world's symmetries (`episodes/symmetries.py`).
        image_transforms: LeRobot's own, for the pictures of training, one draw for each episode. LeRobot does not tell
            a policy of `--dataset.image_transforms`, which changes frames that these policies do not look at.
        language_model: Architecture of the pretrained language encoder; filled in, so that a checkpoint needs no
            download.
        vision_model: The same of a vision backbone that is no resnet of torchvision.
        vocabulary: Words of the training instructions; filled in from the dataset, as are the following.
        lexicon: Names of things and phrases of the training instructions, with their token ids.
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
    freeze_vision_backbone: bool = False
    ignored_action_dimensions: list[int] | None = None
    feature_info: dict[str, dict[str, Any]] | None = None

    ask_observations: bool = True
    names: bool = True
    augment: bool = True
    image_transforms: ImageTransformsConfig = field(default_factory=ImageTransformsConfig)

    action_head: str = "mean"
    action_amplification: float = 1.0
    action_bins: int = 11
    action_components: int = 5
    # The paper does not say how categorical actions are picked. A policy that always takes the most probable one walks
    # in circles where a demonstrator would not (docs/results.md has both).
    action_temperature: float = 1.0
    action_seed: int = 0

    numbers: list[str] | None = None
    episode_store: str = "memory"
    image_size: int | None = 128
    excerpt_steps: int | None = None
    lookback_steps: int | None = None

    optimizer_lr: float | None = None
    optimizer_lr_language: float | None = None
    optimizer_betas: tuple[float, float] = (0.9, 0.999)
    optimizer_eps: float = 1e-8
    optimizer_weight_decay: float = 0.0
    optimizer_grad_clip_norm: float = 1.0  # the paper names none; whole episodes give rare large gradients
    scheduler: str = "constant"
    scheduler_warmup_steps: int = 200

    # What is not named of STATE and ACTION becomes MEAN_STD, as in LeRobot's policies: the weights of losses and the
    # learning rates then mean the same whatever units a robot speaks in. Categorical actions stay as they are.
    normalization_mapping: dict[str, NormalizationMode] = field(
        default_factory=lambda: {"ENV": NormalizationMode.IDENTITY, "VISUAL": NormalizationMode.IDENTITY}
    )

    dtype: str = "float32"  # "bfloat16" trains in mixed precision: LeRobot's accelerator reads this field

    language_model: dict[str, Any] | None = None
    vision_model: dict[str, Any] | None = None
    vocabulary: list[str] = field(default_factory=list)
    lexicon: dict[str, list[int]] = field(default_factory=dict)
    action_classes: int | None = None
    max_timesteps: int | None = None

    # The least and the greatest value of each number. They keep NaN out, too, and sizes from filling the memory.
    BOUNDS: ClassVar[dict[str, tuple[float, float]]] = {
        "dim_model": (2, 8192),
        "n_heads": (1, 512),
        "dropout": (0, 1),
        "action_amplification": (0, 1e6),
        "action_bins": (2, 10_000),
        "action_components": (1, 1_000),
        "action_temperature": (0, 1e6),
        "action_seed": (0, 2**62),
        "optimizer_lr": (0, 100),
        "optimizer_lr_language": (0, 100),
        "optimizer_eps": (0, 1),
        "optimizer_weight_decay": (0, 100),
        "optimizer_grad_clip_norm": (0, 1e9),
        "scheduler_warmup_steps": (0, 10**9),
        "action_classes": (0, 100_000),
        "max_timesteps": (1, 10**7),
        "image_size": (1, 10_000),
        "excerpt_steps": (0, 10**7),
        "lookback_steps": (0, 10**7),
    }

    EXCERPT_STEPS: ClassVar[int] = 0  # what those that can learn from parts of episodes learn from, with pictures
    LOOKBACK_STEPS: ClassVar[int] = 0

    def __post_init__(self) -> None:
        """Refuse settings that cannot work, before anything is loaded or allocated."""
        _check_device(self.device)
        super().__post_init__()
        self._check_choice("episode_store", ("memory", "disk", "device"))
        self._check_choice("action_head", ("mean", "bins", "mixture"))
        self._check_choice("scheduler", ("constant", "cosine"))
        self._check_choice("dtype", ("float32", "bfloat16", "float16"))
        for name, (least, most) in self.BOUNDS.items():
            self._check_number(name, getattr(self, name), least, most)
        for beta in self.optimizer_betas:
            self._check_number("optimizer_betas", beta, 0, 0.999999)
        if self.dim_model % 2 or self.dim_model % self.n_heads:
            raise UserError(
                f"--policy.dim_model={self.dim_model} must be even and a multiple of --policy.n_heads={self.n_heads}: "
                "choose e.g. 128 and 4"
            )
        self._check_size()
        if self.use_amp and self.dtype == "float32":
            self.dtype = "bfloat16"  # which is what LeRobot looks at where a policy has such a field
        if self.excerpt_steps and not self.EXCERPT_STEPS:
            raise UserError(f"--policy.excerpt_steps={self.excerpt_steps}: {self.type} learns from whole episodes only")
        self._is_checkpoint = self.max_timesteps is not None

    def _check_choice(self, name: str, choices: tuple[str, ...]) -> None:
        if getattr(self, name) not in choices:
            raise UserError(f"--policy.{name}={_short(getattr(self, name))} is not one of: {', '.join(choices)}")

    def _check_number(self, name: str, value: float | None, least: float, most: float) -> None:
        if value is not None and not least <= value <= most:  # NaN is neither
            raise UserError(f"--policy.{name}={_short(value)} must be between {least:g} and {most:g}")

    def _check_size(self) -> None:
        count = self._count_parameters()
        if count > MOST_PARAMETERS:
            raise UserError(
                f"the policy would have about {count:.1e} parameters, {MOST_PARAMETERS:.0e} is the most: choose a "
                f"smaller --policy.dim_model than {self.dim_model}, or fewer layers, codes, bins, steps or features"
            )

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

    @property
    def language_rate(self) -> float:
        """Learning rate of the language encoder."""
        if self.optimizer_lr_language is not None:
            return self.optimizer_lr_language
        return self.policy_rate if self.language_encoder == WORDS else 1e-6

    @property
    def policy_rate(self) -> float:
        """Learning rate of the parameters that predict actions."""
        return PAPERS_RATE if self.optimizer_lr is None else self.optimizer_lr

    # What a dataset tells.

    def set_dataset_feature_metadata(self, features: dict[str, dict[str, Any]]) -> None:
        """Take from a dataset's `info.json` what its `PolicyFeature`s do not say: a hook that LeRobot's factory calls.

        Integer and boolean observations become symbols unless they are `numbers`, an integer action becomes
        categorical. What the user has set stays.

        Raises:
            UserError: An ignored action has no name.
        """
        for key, feature in (self.input_features or {}).items():
            described = features.get(key, {})
            whole = _is_integer(described) or described.get("dtype") == "bool"
            if feature.type is FeatureType.STATE and whole and key not in (self.numbers or []):
                # Out of reach of STATE scaling.
                self.input_features[key] = PolicyFeature(FeatureType.ENV, feature.shape)
            elif key == OBS_ENV_STATE and key in features and not _is_integer(features[key]):
                # LeRobot calls it ENV whatever it holds; as symbols, real numbers would be cut to integers.
                self.input_features[key] = PolicyFeature(FeatureType.STATE, feature.shape)
        action = features.get(ACTION, {})
        if action.get("dtype") == "bool":  # switches, which have no mean to be taken off
            self.normalization_mapping.setdefault("ACTION", NormalizationMode.IDENTITY)
        if self.action_classes is None:
            self.action_classes = _count_classes(action)
        if self.ignored_action_dimensions is None:
            self.ignored_action_dimensions = _ignored_dimensions(action)
        self.feature_info = feature_info(features)  # of the data it is trained on now, whatever came before

    def set_dataset_statistics(self, stats: dict[str, dict[str, Any]] | None, longest: int) -> None:
        """Take from a dataset what only its contents tell; comes after `set_dataset_feature_metadata`.

        Args:
            stats: Its statistics; they tell how many actions there are where `info.json` does not.
            longest: Frames in its longest episode, how far rollouts will look back.

        Raises:
            UserError: A feature holds more symbols or actions than there is room for.
        """
        for key, feature in (self.input_features or {}).items():
            low, high = _range(key, stats)
            if feature.type is not FeatureType.ENV or (low >= 0 and high < SYMBOLS):
                continue
            if self.numbers is not None:
                raise UserError(
                    f"`{key}` holds integers from {low:g} to {high:g}, but symbols are 0..{SYMBOLS - 1}: "
                    "name it in --policy.numbers, or leave it out of --policy.input_features"
                )
            logging.warning("`%s` holds integers from %g to %g: numbers, no symbols", key, low, high)
            self.input_features[key] = PolicyFeature(FeatureType.STATE, feature.shape)
        low, high = _range(ACTION, stats)
        if self.action_classes is None:
            if "max" not in (stats or {}).get(ACTION, {}):
                raise UserError(
                    "the dataset does not say how many different actions there are: pass --policy.action_classes=N"
                )
            self.action_classes = int(high) + 1
        if self.action_classes and (low < 0 or high >= self.action_classes):
            fix = "number them from 0" if low < 0 else f"pass {high + 1:g} or more"
            raise UserError(
                f"--policy.action_classes={self.action_classes} does not fit the dataset, whose actions are {low:g} to "
                f"{high:g}: {fix}, or pass 0 to treat them as real numbers"
            )
        if self.max_timesteps is None:
            self.max_timesteps = longest

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

    # Which features the networks can take.

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
        if self.is_scaled(FeatureType.ENV):
            raise UserError(
                "ENV features hold symbols, which cannot be normalised: set normalization_mapping ENV to IDENTITY"
            )
        self._check_action()
        self._check_frozen()
        self._check_size()

    def _check_observation(self, key: str, feature: PolicyFeature) -> None:
        kind, shape = feature.type, tuple(feature.shape)
        if kind not in (FeatureType.STATE, FeatureType.ENV, FeatureType.VISUAL):
            raise UserError(
                f"{self.type} cannot read `{key}` of type {kind.value}: leave it out of --policy.input_features"
            )
        if kind is FeatureType.VISUAL and len(shape) != 3:
            raise UserError(f"image `{key}` has shape {shape}: it must be (channels, height, width)")
        if any(side < 1 for side in shape):
            raise UserError(f"`{key}` has the empty shape {shape}: leave it out of --policy.input_features")
        if kind is FeatureType.VISUAL and self.is_scaled(kind) and max(shape[1:]) > (self.image_size or max(shape)):
            raise UserError(
                f"image `{key}` is made smaller to {self.image_size} pixels, so it cannot be normalised before: set "
                "normalization_mapping VISUAL to IDENTITY (encoders scale pictures themselves), or "
                "--policy.image_size=null"
            )

    def _check_frozen(self) -> None:
        """What a frozen backbone is asked once cannot change afterwards."""
        if not self.freeze_vision_backbone:
            return
        if self.vision_backbone is None:
            raise UserError("--policy.freeze_vision_backbone=true needs a --policy.vision_backbone to keep as it is")
        if self.image_transforms.enable or self.is_scaled(FeatureType.VISUAL):
            raise UserError(
                "a frozen vision backbone is asked once for each frame, as it was recorded: set normalization_mapping "
                "VISUAL to IDENTITY and --policy.image_transforms.enable=false, or freeze_vision_backbone=false"
            )

    def _check_action(self) -> None:
        action = self.action_feature
        if action is None:
            raise UserError(
                f"{self.type} needs a feature called `action`: the dataset has {sorted(self.output_features or {})}"
            )
        if len(action.shape) != 1:
            raise UserError(
                f"{self.type} takes a flat action, but `action` has shape {tuple(action.shape)}: flatten it"
            )
        if self.action_classes and action.shape[0] != 1:
            raise UserError(
                f"the policy chooses one of {self.action_classes} actions, but `action` here has {action.shape[0]} "
                "numbers: evaluate it in the world it was trained in (for integers of a dataset that are no choices, "
                "pass --policy.action_classes=0)"
            )
        if self.action_classes and self.is_scaled(FeatureType.ACTION):
            raise UserError("a categorical action cannot be normalised: set normalization_mapping ACTION to IDENTITY")
        ignored = self.ignored_action_dimensions or []
        outside = [d for d in ignored if not 0 <= d < action.shape[0]]
        if outside or len(set(ignored)) >= action.shape[0]:
            raise UserError(
                f"--policy.ignored_action_dimensions={_short(ignored)} must leave at least one of the "
                f"{action.shape[0]} dimensions 0..{action.shape[0] - 1}"
            )

    def is_scaled(self, kind: FeatureType) -> bool:
        """Whether the preprocessor scales features of a kind."""
        mode = self.normalization_mapping.get(kind.value, NormalizationMode.IDENTITY)
        return mode is not NormalizationMode.IDENTITY


@draccus.encode.register(EpisodePolicyConfig, include_subclasses=True)
def _encode(config: EpisodePolicyConfig, _: Any = None) -> dict[str, Any]:
    """For `config.json` and `train_config.json`."""
    old = {f.name for f in fields(OldFields)}
    return {key: value for key, value in encode_choice(config, PreTrainedConfig).items() if key not in old}


def _short(value: object) -> str:
    """A value in a message: nobody reads more of it."""
    text = str(value)
    return text if len(text) <= 60 else f"{text[:60]}..."


def _check_device(device: str | None) -> None:
    """Before LeRobot does, whose words draccus swallows."""
    try:
        known = not device or torch.device(device).type in DEVICES
    except RuntimeError:
        known = False
    if not known:
        raise UserError(f"--policy.device={_short(device)} is not one of: {', '.join(DEVICES)}, cuda:0, cuda:1, ...")


def _is_integer(feature: dict[str, Any]) -> bool:
    return str(feature.get("dtype", "")).startswith(("int", "uint"))


def _count_classes(action: dict[str, Any]) -> int | None:
    """Number of different actions as `info.json` tells it: 0 for real-valued ones, None if it does not."""
    if action.get("dtype") == "bool":
        return 2 if math.prod(action["shape"]) == 1 else 0
    if not _is_integer(action) or math.prod(action["shape"]) != 1:
        return 0
    names = action.get("names")
    return len(names["classes"]) if isinstance(names, dict) and names.get("classes") else None


def _ignored_dimensions(action: dict[str, Any]) -> list[int]:
    """Dimensions that a dataset names as ignored by its environment."""
    ignored = (action.get("info") or {}).get("ignored") or []
    names = list(action.get("names") or [])
    unknown = [name for name in ignored if name not in names]
    if unknown:
        raise UserError(f"the dataset's action says that {unknown} is ignored, but its names are {names}: correct one")
    return [names.index(name) for name in ignored]


def _range(key: str, stats: dict[str, dict[str, Any]] | None) -> tuple[float, float]:
    """Least and greatest value of a feature; 0 and 0 where the statistics do not tell."""
    known = (stats or {}).get(key, {})
    low, high = (float(getattr(known[name], name)()) if name in known else 0.0 for name in ("min", "max"))
    return low, high
