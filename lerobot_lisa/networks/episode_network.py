"""What a policy's network can do, whatever is inside: predict over whole episodes, and act step by step."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from torch import Tensor, nn

from lerobot_lisa.networks.actions import ActionHead
from lerobot_lisa.networks.language import LanguageEncoder
from lerobot_lisa.networks.observations import ObservationEncoder
from lerobot_lisa.networks.transformer import EVERYTHING


@dataclass
class History:
    """A rollout so far, for B environments that were reset together.

    Attributes:
        step: Steps since reset.
        actions: (B, A) previous actions; set by whoever picks them.
        looks: (B, places) where was looked in the newest observation; None if observations keep no parts.
        questions: (B,) how many questions it was asked; each looks once, at places or at nothing.
    """

    step: int = 0
    actions: Tensor | None = None
    looks: Tensor | None = None
    questions: Tensor | None = None


class EpisodeNetwork(nn.Module, ABC):
    """Base of all policies' networks."""

    language: LanguageEncoder
    observations: ObservationEncoder

    @property
    @abstractmethod
    def head(self) -> ActionHead:
        """What turns predictions into losses and actions."""

    @property
    def reach(self) -> int:
        """How many steps before a prediction, or before the chunk that it belongs to, can matter to it: here, all."""
        return EVERYTHING

    @abstractmethod
    def begin(self, tokens: Tensor, tokens_valid: Tensor) -> Any:
        """Start a rollout with instructions (B, M), padding at the end; returns its `History`."""

    @abstractmethod
    def act(self, history: Any, observations: Mapping[str, Tensor]) -> Tensor:
        """Take one more step.

        Args:
            history: From `begin`; extended in place, except for `actions`.
            observations: This step's features, each (B, *shape).

        Returns:
            Predictions (B, ...).
        """
