"""Settings of the Lang-DT policy."""

from dataclasses import dataclass

from lerobot.configs import PreTrainedConfig

from lerobot_lisa.errors import UserError
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

    def __post_init__(self) -> None:
        """Refuse settings that cannot work, before anything is loaded."""
        super().__post_init__()
        if self.n_layers < 1:
            raise UserError(f"--policy.n_layers={self.n_layers} must be at least 1")
        if not 0 <= self.padding_waste <= 1:
            raise UserError(f"--policy.padding_waste={self.padding_waste} must be between 0 and 1")
