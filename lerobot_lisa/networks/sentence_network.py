"""Networks that hear an instruction as one vector, as those of the original baselines do."""

from dataclasses import dataclass
from typing import ClassVar

from torch import Tensor, nn

from lerobot_lisa.networks.actions import ActionHead
from lerobot_lisa.networks.episode_network import EpisodeNetwork, History
from lerobot_lisa.networks.language import LanguageEncoder


@dataclass(kw_only=True)
class SentenceHistory(History):
    """The rollout so far.

    Attributes:
        sentences: (B, D), what was said.
    """

    sentences: Tensor


class SentenceNetwork(EpisodeNetwork):
    """Base of these networks.

    Attributes:
        history: Of their rollouts.
        policy: Whose last layer is the head.
    """

    history: ClassVar[type[SentenceHistory]] = SentenceHistory
    language: LanguageEncoder
    policy: nn.Sequential

    @property
    def head(self) -> ActionHead:
        """The policy's last layer."""
        return self.policy[-1]  # type: ignore[return-value]

    def begin(self, tokens: Tensor, tokens_valid: Tensor) -> SentenceHistory:
        """Start a rollout: all that is remembered of it is the instruction."""
        return self.history(sentences=self.language(tokens, tokens_valid).sentence())
