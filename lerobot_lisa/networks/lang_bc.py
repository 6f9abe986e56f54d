"""Language-conditioned behaviour cloning: what is said and what is seen now to an action, nothing remembered."""

from collections.abc import Mapping

import torch
from torch import Tensor, nn

from lerobot_lisa.networks.actions import ActionHead
from lerobot_lisa.networks.language import LanguageEncoder
from lerobot_lisa.networks.mlp import hidden_layers
from lerobot_lisa.networks.observations import ObservationEncoder
from lerobot_lisa.networks.packing import Packing
from lerobot_lisa.networks.sentence_network import SentenceHistory, SentenceNetwork


class LangBC(SentenceNetwork):
    """LCBC, the imitating baseline of LOReL (Nair et al., CoRL 2021, arXiv:2109.01115): an MLP.

    Args:
        language: Instructions to tokens, whose mean the MLP gets.
        observations: What it sees with.
        width: D.
        dropout: After each of its hidden layers.
        head: Of `width`.
    """

    def __init__(
        self,
        language: LanguageEncoder,
        observations: ObservationEncoder,
        width: int,
        dropout: float,
        head: ActionHead,
    ) -> None:
        super().__init__()
        self.language, self.observations = language, observations
        self.policy = nn.Sequential(hidden_layers(2 * width, width, dropout), head)

    def forward(
        self,
        tokens: Tensor,
        tokens_valid: Tensor,
        observations: Mapping[str, Tensor],
        actions: Tensor,
        packing: Packing,
    ) -> Tensor:
        """Predict every action of B whole episodes; arguments as in `Lisa.forward`. Actions are not looked at."""
        return self._choose(self.language(tokens, tokens_valid).sentence()[packing.sequence], observations)

    def act(self, history: SentenceHistory, observations: Mapping[str, Tensor]) -> Tensor:
        """Take one more step."""
        history.step += 1
        return self._choose(history.sentences, observations)

    def _choose(self, sentences: Tensor, observations: Mapping[str, Tensor]) -> Tensor:
        """Predictions for N frames, a sentence (N, D) for each."""
        seen = self.observations(observations, sentences[:0]).summary  # nothing is asked, so no names are needed
        return self.policy(torch.cat([seen, sentences], dim=-1))
