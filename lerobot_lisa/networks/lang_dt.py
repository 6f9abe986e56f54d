"""Lang-DT: one causal transformer over the instruction and the whole episode so far."""

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from lerobot_lisa.networks.action_predictor import ActionPredictor
from lerobot_lisa.networks.actions import ActionHead
from lerobot_lisa.networks.episode_network import EpisodeNetwork, History
from lerobot_lisa.networks.language import LanguageEncoder
from lerobot_lisa.networks.observations import ObservationEncoder
from lerobot_lisa.networks.packing import Packing, by_length
from lerobot_lisa.networks.transformer import Memory


@dataclass(kw_only=True)
class LangDTHistory(History):
    """Lang-DT's rollout so far.

    Attributes:
        policy: What the transformer remembers of the instruction and the episode.
    """

    policy: Memory


class LangDT(EpisodeNetwork):
    """A Decision Transformer conditioned on the instruction instead of returns (paper, section 4.1)."""

    def __init__(
        self,
        language: LanguageEncoder,
        observations: ObservationEncoder,
        policy: ActionPredictor,
        padding_waste: float,
    ) -> None:
        super().__init__()
        self.language, self.observations, self.policy = language, observations, policy
        self.padding_waste = padding_waste

    def forward(
        self,
        tokens: Tensor,
        tokens_valid: Tensor,
        observations: Mapping[str, Tensor],
        actions: Tensor,
        packing: Packing,
    ) -> Tensor:
        """Predict every action of B whole episodes; arguments as in `Lisa.forward`."""
        language, seen = self.language(tokens, tokens_valid), self.observations(observations)
        predictions, order = [], []
        for group in by_length(packing.lengths, self.padding_waste):
            rows = packing.rows(group)
            group_packing = Packing(packing.lengths[group], packing.device)
            where = group.to(tokens.device)
            predictions.append(
                self.policy(language[where], tokens_valid[where], seen[rows], actions[rows], group_packing)
            )
            order.append(rows)
        return torch.cat(predictions)[torch.cat(order).argsort()]

    @property
    def head(self) -> ActionHead:
        """The transformer's."""
        return self.policy.head

    def begin(self, tokens: Tensor, tokens_valid: Tensor) -> LangDTHistory:
        """Start a rollout: show the transformer the instructions."""
        return LangDTHistory(policy=self.policy.begin(self.language(tokens, tokens_valid), tokens_valid))

    def act(self, history: LangDTHistory, observations: Mapping[str, Tensor]) -> Tensor:
        """Take one more step."""
        history.step += 1
        return self.policy.step(history.policy, history.step - 1, self.observations(observations), history.actions)
