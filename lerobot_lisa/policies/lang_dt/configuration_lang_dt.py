"""Settings of the Lang-DT policy."""

from dataclasses import dataclass
from typing import ClassVar

from lerobot.configs import PreTrainedConfig

from lerobot_lisa.policies.base_configuration import EpisodePolicyConfig


@PreTrainedConfig.register_subclass("lang_dt")
@dataclass
class LangDTConfig(EpisodePolicyConfig):
    """The flat baseline of the LISA paper: a Decision Transformer that is given the instruction instead of returns.

    Attributes:
        n_layers: Transformer blocks; two, so that its size matches LISA's one plus one (paper, section 4.1).
        padding_waste: Episodes are grouped by length so that at most this share of a group is padding.
    """

    n_layers: int = 2
    padding_waste: float = 0.15

    BOUNDS: ClassVar[dict[str, tuple[float, float]]] = {
        **EpisodePolicyConfig.BOUNDS,
        "n_layers": (1, 128),
        "padding_waste": (0, 1),
    }

    EXCERPT_STEPS: ClassVar[int] = 80
    LOOKBACK_STEPS: ClassVar[int] = 40  # of each of its blocks
