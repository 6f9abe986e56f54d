"""Settings that the original baselines share: what is ours in LISA and Lang-DT is not in them."""

from dataclasses import dataclass

from lerobot_lisa.errors import UserError
from lerobot_lisa.policies.base_configuration import EpisodePolicyConfig


@dataclass
class BaselineConfig(EpisodePolicyConfig):
    """Shared part of the original baselines (docs/baselines.md). They have no attention, so `n_heads` means nothing.

    Attributes:
        ask_observations: They see every frame as one vector: false.
        augment: They train on what was demonstrated; true is for comparisons with policies that augment.
    """

    ask_observations: bool = False
    augment: bool = False

    def __post_init__(self) -> None:
        """Refuse what they cannot do."""
        super().__post_init__()
        if self.ask_observations:
            raise UserError(
                f"--policy.ask_observations=true: {self.type} sees every frame as one vector; lisa and lang_dt ask"
            )
