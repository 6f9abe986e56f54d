"""LOReL's planner: a model of the world and a judge of what was told, both learned, and a search for good actions."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from lerobot_lisa.networks.cross_entropy import CrossEntropySearch
from lerobot_lisa.networks.language import LanguageEncoder
from lerobot_lisa.networks.mlp import hidden_layers
from lerobot_lisa.networks.observations import side_by_side
from lerobot_lisa.networks.packing import Packing
from lerobot_lisa.networks.real_actions import RealHead
from lerobot_lisa.networks.sentence_network import SentenceHistory, SentenceNetwork


@dataclass(kw_only=True)
class PlannerHistory(SentenceHistory):
    """The rollout so far.

    Attributes:
        start: (B, S), the first state; None before the first step.
        generator: What the search draws from; None: torch's own.
    """

    start: Tensor | None = None
    generator: torch.Generator | None = None


class Judged(NamedTuple):
    """What the judge said of a batch.

    Attributes:
        judge_loss: Scalar.
        judge_accuracy: Scalar, share of right answers, true and false ones counted alike.
    """

    judge_loss: Tensor
    judge_accuracy: Tensor


class PlannedActions(RealHead):
    """Predictions are the planned actions themselves; actions enter the model of the world through `embed`."""

    def forward(self, hidden: Tensor) -> Tensor:
        """Actions (N, A), as they are."""
        return hidden

    def loss(self, outputs: Tensor, actions: Tensor) -> Tensor:
        """How far plans are from what was done, (N,); nothing learns from it."""
        return self._average((outputs - actions.float()).square())

    def most_probable(self, outputs: Tensor) -> Tensor:
        """The plan, (N, A)."""
        return outputs

    def draw(self, outputs: Tensor, generator: torch.Generator | None) -> Tensor:
        """The plan, (N, A)."""
        return self._within_bounds(outputs)


class LorelPlanner(SentenceNetwork):
    """Nair et al., CoRL 2021 (arXiv:2109.01115), on states.

    The judge says whether the change from a first state to another one is what was told. Actions are sought whose
    states, as the model of the world predicts them, it likes best.

    Args:
        language: Instructions to tokens, whose mean is what was told.
        keys: Features that are laid side by side as the state.
        size: S, numbers of the state.
        width: D.
        dropout: In model and judge.
        head: Bounds of actions, and which of them count.
        search: For actions.
    """

    history = PlannerHistory

    def __init__(
        self,
        language: LanguageEncoder,
        keys: Sequence[str],
        size: int,
        width: int,
        dropout: float,
        head: PlannedActions,
        search: CrossEntropySearch,
    ) -> None:
        super().__init__()
        self.language, self.keys, self.actions, self.search = language, list(keys), head, search
        self.model = nn.Sequential(hidden_layers(size + width, width, dropout), nn.Linear(width, size))
        self.judge = nn.Sequential(hidden_layers(3 * size + width, width, dropout), nn.Linear(width, 1))

    def forward(
        self,
        tokens: Tensor,
        tokens_valid: Tensor,
        observations: Mapping[str, Tensor],
        actions: Tensor,
        packing: Packing,
    ) -> tuple[Tensor, Judged]:
        """Predict the next state of all N frames (N, S), and judge B whole episodes; arguments as in `Lisa.forward`."""
        states, sentences = self.state(observations), self.language(tokens, tokens_valid).sentence()
        last = packing.lengths.cumsum(0) - 1
        first = (last - packing.lengths + 1).to(states.device)
        judged = self._judge(states[first], states[last.to(states.device)], sentences, tokens)
        return self.predict(states, actions), judged

    def predict(self, states: Tensor, actions: Tensor) -> Tensor:
        """States (N, S) that follow states (N, S) and actions (N, A)."""
        return states + self.model(torch.cat([states, self.actions.embed(actions)], dim=-1))

    def rewards(self, start: Tensor, states: Tensor, sentences: Tensor) -> Tensor:
        """Logits (N,) of "what was told (N, D) has been done since the start (N, S), now that states (N, S) are so"."""
        return self.judge(torch.cat([start, states, states - start, sentences], dim=-1))[:, 0]

    def state(self, observations: Mapping[str, Tensor]) -> Tensor:
        """All features of N frames side by side, (N, S)."""
        return side_by_side(observations, self.keys)

    @property
    def head(self) -> PlannedActions:
        """Plans are actions."""
        return self.actions

    def act(self, history: PlannerHistory, observations: Mapping[str, Tensor]) -> Tensor:
        """Plan anew, and take the first action of the plan (B, A)."""
        states = self.state(observations)
        if history.start is None:
            history.start = states
        history.step += 1
        start, sentences = history.start, history.sentences

        def value(candidates: Tensor) -> Tensor:
            """Sum of rewards along plans (B, n, T, A) -> (B, n)."""
            plans = candidates.shape[1]
            begun, told, now = (part.repeat_interleave(plans, 0) for part in (start, sentences, states))
            total = now.new_zeros(len(now))
            for action in candidates.flatten(0, 1).unbind(1):
                now = self.predict(now, action)
                total = total + self.rewards(begun, now, told).sigmoid()
            return total.view(-1, plans)

        return self.search(value, self.actions.bounds, len(states), history.generator)[:, 0]

    def _judge(self, first: Tensor, last: Tensor, sentences: Tensor, tokens: Tensor) -> Judged:
        """What B episodes say: their instruction is done at their end; another one is not, nor is it done backwards."""
        other = torch.arange(len(tokens), device=tokens.device).roll(_turn(len(tokens), self.training))
        moved = (first != last).any(1)
        kinds = [
            (self.rewards(first, last, sentences), moved, 1.0),
            (self.rewards(first, last, sentences[other]), moved & (tokens != tokens[other]).any(1), 0.0),
            (self.rewards(last, first, sentences), moved, 0.0),
        ]
        losses = [_mean(_cross_entropy(logits, answer), counts) for logits, counts, answer in kinds]
        right = [_mean(((logits > 0) == bool(answer)).float(), counts) for logits, counts, answer in kinds]
        return Judged(*(part[0] / 2 + (part[1] + part[2]) / 4 for part in (losses, right)))


def _turn(episodes: int, random: bool) -> int:
    """How far away in the batch the other instruction is."""
    return int(torch.randint(1, episodes, ())) if random and episodes > 2 else 1


def _cross_entropy(logits: Tensor, answer: float) -> Tensor:
    return F.binary_cross_entropy_with_logits(logits.float(), torch.full_like(logits, answer).float(), reduction="none")


def _mean(values: Tensor, counts: Tensor) -> Tensor:
    """Of those that count; 0 if none does."""
    return (values * counts).sum() / counts.sum().clamp(min=1)
