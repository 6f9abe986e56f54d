"""The settings that all policies here share, their defaults, and the bounds of their numbers."""

from dataclasses import dataclass, field
from typing import Any, ClassVar

from lerobot.configs import FeatureType, NormalizationMode, PreTrainedConfig
from lerobot.transforms import ImageTransformsConfig

from lerobot_lisa.policies.old_fields import OldFields

WORDS = "words"  # the built-in word-level language encoder
SYMBOLS = 16  # more than minigrid's 11 objects, 6 colours and 3 door states
PAPERS_RATE = 1e-4


@dataclass
class EpisodeSettings(OldFields, PreTrainedConfig):
    """What `EpisodePolicyConfig` holds. Defaults are the paper's (appendix D) unless a comment says why.

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

    def is_scaled(self, kind: FeatureType) -> bool:
        """Whether the preprocessor scales features of a kind."""
        mode = self.normalization_mapping.get(kind.value, NormalizationMode.IDENTITY)
        return mode is not NormalizationMode.IDENTITY
