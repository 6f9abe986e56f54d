"""LOReL's planner: a model of the world and a judge of what was told, both learned, and a search for good actions."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import torch
from torch import Tensor

from lerobot_lisa.networks.cross_entropy import CrossEntropySearch
from lerobot_lisa.networks.judge import Judge, Judged
from lerobot_lisa.networks.language import LanguageEncoder
from lerobot_lisa.networks.observations import side_by_side
from lerobot_lisa.networks.packing import Packing
from lerobot_lisa.networks.real_actions import RealHead
from lerobot_lisa.networks.sentence_network import SentenceHistory, SentenceNetwork
from lerobot_lisa.networks.world_model import WorldModel


@dataclass(kw_only=True)
class PlannerHistory(SentenceHistory):
    """The rollout so far.

    Attributes:
        start: (B, S), the first state; None before the first step.
        state: (B, S), the newest one.
        memory: Of the model of the world, of all steps before this one.
        plan: (B, T, A), the newest.
        generator: What the search draws from; None: torch's own.
    """

    start: Tensor | None = None
    state: Tensor | None = None
    memory: Tensor | None = None
    plan: Tensor | None = None
    generator: torch.Generator | None = None


class PlannedActions(RealHead):
    """Predictions are the planned actions themselves.

    Args:
        weights: See `RealHead`.
        bounds: See `RealHead`.
    """

    def __init__(self, weights: Tensor, bounds: Tensor) -> None:
        super().__init__(1, weights, bounds)
        del self.embedding  # the model of the world takes actions as they are

    def embed(self, actions: Tensor) -> Tensor:
        """Actions (..., A) as they are, but without what the environment ignores."""
        return actions.float() * self.weights

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
    states, as the model of the world imagines them, it likes best.

    Args:
        language: Instructions to tokens, whose mean is what was told.
        keys: Features that are laid side by side as the state.
        size: S, numbers of the state.
        width: D.
        dropout: In model and judge.
        head: Bounds of actions, and which of them count.
        steps: T, length of a plan.
        search: For plans.
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
        steps: int,
        search: CrossEntropySearch,
    ) -> None:
        super().__init__()
        self.language, self.keys, self.actions, self.steps, self.search = language, list(keys), head, steps, search
        self.world = WorldModel(size, len(head.weights), width, dropout)
        self.judge = Judge(size, width, dropout)

    def forward(
        self,
        tokens: Tensor,
        tokens_valid: Tensor,
        observations: Mapping[str, Tensor],
        actions: Tensor,
        packing: Packing,
    ) -> tuple[Tensor, Judged]:
        """Imagine the next state of all N frames (N, S), and judge B whole episodes; arguments as in `Lisa.forward`.

        In training each episode is seen up to a random step and imagined from there, in a validation from its first.
        """
        states, sentences = self.state(observations), self.language(tokens, tokens_valid).sentence()
        lengths = packing.lengths.to(states.device)
        seen = (torch.rand(len(lengths)).to(states.device) * (lengths - 1)).long() if self.training else 0 * lengths
        imagined, _ = self.world(packing.pad(states), packing.pad(self.actions.embed(actions)), seen)
        last = lengths.cumsum(0) - 1
        judged = self.judge.learn(states[last - lengths + 1], states[last], sentences, tokens, tokens_valid)
        return packing.unpad(imagined), judged

    def state(self, observations: Mapping[str, Tensor]) -> Tensor:
        """All features of N frames side by side, (N, S)."""
        return side_by_side(observations, self.keys)

    @property
    def head(self) -> PlannedActions:
        """Plans are actions."""
        return self.actions

    def act(self, history: PlannerHistory, observations: Mapping[str, Tensor]) -> Tensor:
        """Plan anew, beginning with what is left of the last plan, and take the plan's first action (B, A)."""
        now, bounds = self.state(observations), self.actions.bounds
        left = bounds.mean(0).expand(len(now), self.steps, -1)
        if history.start is None:
            history.start = now
        if history.state is not None and history.actions is not None and history.plan is not None:
            history.memory = self.world.remember(history.state, self.actions.embed(history.actions), history.memory)
            left = torch.cat([history.plan[:, 1:], left[:, :1]], dim=1)
        history.state, history.step = now, history.step + 1
        value = partial(self._value, history.start, now, history.sentences, history.memory)
        history.plan = self.search(value, bounds, left, history.generator)
        return history.plan[:, 0]

    def _value(self, start: Tensor, now: Tensor, told: Tensor, memory: Tensor | None, plans: Tensor) -> Tensor:
        """The most that the judge says along plans (B, n, T, A), (B, n): done once is done."""
        each = plans.shape[1]
        start, told, now = (part.repeat_interleave(each, 0) for part in (start, told, now))
        memory = None if memory is None else memory.repeat_interleave(each, 1)
        imagined = self.world.imagine(now, self.actions.embed(plans.flatten(0, 1)), memory)
        done = [self.judge(start, states, told) for states in imagined.unbind(1)]
        return torch.stack(done).amax(0).view(-1, each)
