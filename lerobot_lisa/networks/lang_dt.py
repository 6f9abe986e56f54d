"""Lang-DT: one causal transformer over the instruction and the whole episode so far."""

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from lerobot_lisa.networks.action_predictor import ActionPredictor
from lerobot_lisa.networks.actions import ActionHead
from lerobot_lisa.networks.episode_network import EpisodeNetwork, History
from lerobot_lisa.networks.language import Instruction, LanguageEncoder
from lerobot_lisa.networks.observations import ObservationEncoder
from lerobot_lisa.networks.packing import Packing, by_length
from lerobot_lisa.networks.parts import PartAttention, Parts, answered, spread
from lerobot_lisa.networks.transformer import Memory


@dataclass(kw_only=True)
class LangDTHistory(History):
    """Lang-DT's rollout so far.

    Attributes:
        naming: The words of the instruction that name things.
        names: (n, W) of all things, said or not.
        policy: What the transformer remembers of the instruction and the episode.
    """

    naming: Instruction
    names: Tensor
    policy: Memory


class LangDT(EpisodeNetwork):
    """A Decision Transformer conditioned on the instruction instead of returns (paper, section 4.1)."""

    def __init__(
        self,
        language: LanguageEncoder,
        observations: ObservationEncoder,
        action_predictor: ActionPredictor,
        padding_waste: float,
        asks_words: PartAttention | None = None,
    ) -> None:
        super().__init__()
        self.language, self.observations, self.action_predictor = language, observations, action_predictor
        self.padding_waste, self.asks_words = padding_waste, asks_words

    def forward(
        self,
        tokens: Tensor,
        tokens_valid: Tensor,
        observations: Mapping[str, Tensor],
        actions: Tensor,
        packing: Packing,
    ) -> Tensor:
        """Predict every action that is learned from of B whole episodes or excerpts; arguments as in `Lisa.forward`."""
        instruction = self.language(tokens, tokens_valid)
        seen, _, _ = self._look(observations, self.language.names(), instruction.naming(), packing.sequence)
        predictions, order = [], []
        for group in by_length(packing.lengths, self.padding_waste):
            rows = packing.rows(group)
            where = group.to(tokens.device)
            predictions.append(
                self.action_predictor(
                    instruction.tokens[where], tokens_valid[where], seen[rows], actions[rows], packing.take(group)
                )
            )
            order.append(packing.learned.rows(group))
        return torch.cat(predictions)[torch.cat(order).argsort()]

    @property
    def head(self) -> ActionHead:
        """The transformer's."""
        return self.action_predictor.head

    @property
    def reach(self) -> int:
        """Two tokens a step."""
        return (self.action_predictor.transformer.reach + 1) // 2

    def begin(self, tokens: Tensor, tokens_valid: Tensor) -> LangDTHistory:
        """Start a rollout: show the transformer the instructions."""
        instruction = self.language(tokens, tokens_valid)
        policy = self.action_predictor.begin(instruction.tokens, tokens_valid)
        return LangDTHistory(
            naming=instruction.naming(),
            names=self.language.names(),
            policy=policy,
            questions=instruction.names.sum(1),
        )

    def act(self, history: LangDTHistory, observations: Mapping[str, Tensor]) -> Tensor:
        """Take one more step."""
        history.step += 1
        seen, parts, looks = self._look(observations, history.names, history.naming, None)
        history.looks = spread(parts, looks, self.observations.all_places)
        return self.action_predictor.step(history.policy, history.step - 1, seen, history.actions)

    def _look(
        self, observations: Mapping[str, Tensor], names: Tensor, said: Instruction, rows: Tensor | None
    ) -> tuple[Tensor, Parts | None, Tensor | None]:
        """N frames, words having asked for things: (N, D), parts, and attention to them (N, Q, P)."""
        seen = self.observations(observations, names)
        heard, looks = answered(self.asks_words, seen, said.phrases, said.tokens, said.valid, rows)
        return heard, seen.parts, looks
