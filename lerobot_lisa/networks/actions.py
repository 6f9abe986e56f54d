"""Action heads: how actions are embedded, what their loss is and how one is picked."""

from abc import ABC, abstractmethod

import torch
import torch.nn.functional as F
from torch import Tensor, nn


class ActionHead(nn.Module, ABC):
    """What both kinds of action share."""

    @abstractmethod
    def forward(self, hidden: Tensor) -> Tensor:
        """Hidden states (N, D) to predictions."""

    @abstractmethod
    def embed(self, actions: Tensor) -> Tensor:
        """Actions (N, A) as input tokens (N, D)."""

    @abstractmethod
    def loss(self, outputs: Tensor, actions: Tensor) -> Tensor:
        """Loss (N,) of predictions against the actions (N, A) that were taken."""

    @abstractmethod
    def pick(self, outputs: Tensor, generator: torch.Generator | None = None) -> Tensor:
        """Actions (N, A) for predictions; `generator` makes drawing them exact."""

    @abstractmethod
    def metrics(self, outputs: Tensor, actions: Tensor) -> dict[str, Tensor]:
        """Scalars worth logging."""


class CategoricalHead(ActionHead):
    """One of several actions: cross-entropy, and an action is drawn or the most probable one taken.

    Args:
        width: D.
        classes: How many actions there are.
        temperature: Of the softmax that actions are drawn from; 0 takes the most probable one.
    """

    def __init__(self, width: int, classes: int, temperature: float = 1.0) -> None:
        super().__init__()
        self.temperature = temperature
        self.embedding = nn.Embedding(classes, width)
        self.logits = nn.Linear(width, classes)

    def forward(self, hidden: Tensor) -> Tensor:
        """(N, D) -> logits (N, classes)."""
        return self.logits(hidden)

    def embed(self, actions: Tensor) -> Tensor:
        """(N, 1) -> (N, D)."""
        return self.embedding(actions[..., 0].long())

    def loss(self, outputs: Tensor, actions: Tensor) -> Tensor:
        """Cross-entropy in nats, (N,)."""
        return F.cross_entropy(outputs.float(), actions[:, 0].long(), reduction="none")

    def pick(self, outputs: Tensor, generator: torch.Generator | None = None) -> Tensor:
        """A class as float (N, 1), which is how LeRobot hands actions to environments."""
        if self.temperature == 0:
            return outputs.argmax(-1, keepdim=True).float()
        probabilities = torch.softmax(outputs.float() / self.temperature, dim=-1)
        return torch.multinomial(probabilities, 1, generator=generator).float()

    def metrics(self, outputs: Tensor, actions: Tensor) -> dict[str, Tensor]:
        """Share of frames whose most probable action is the demonstrated one."""
        return {"action_accuracy": (outputs.argmax(-1) == actions[:, 0].long()).float().mean()}


class ContinuousHead(ActionHead):
    """Real-valued actions: squared error, and the mean is taken (paper, section 3.2)."""

    weights: Tensor

    def __init__(self, width: int, size: int, weights: Tensor | None = None) -> None:
        super().__init__()
        self.embedding = nn.Linear(size, width)
        self.mean = nn.Linear(width, size)
        # 0 for dimensions that the environment ignores: their noise would drown the others.
        self.register_buffer("weights", torch.ones(size) if weights is None else weights)

    def forward(self, hidden: Tensor) -> Tensor:
        """(N, D) -> mean action (N, A)."""
        return self.mean(hidden)

    def embed(self, actions: Tensor) -> Tensor:
        """(N, A) -> (N, D); ignored dimensions are not seen either."""
        return self.embedding(actions.float() * self.weights)

    def loss(self, outputs: Tensor, actions: Tensor) -> Tensor:
        """Squared error averaged over the dimensions that count, (N,)."""
        error = (outputs.float() - actions.float()).square() * self.weights
        return error.sum(-1) / self.weights.sum()

    def pick(self, outputs: Tensor, generator: torch.Generator | None = None) -> Tensor:
        """The mean, (N, A)."""
        return outputs

    def metrics(self, outputs: Tensor, actions: Tensor) -> dict[str, Tensor]:
        """Mean absolute error over the dimensions that count."""
        error = (outputs - actions).abs() * self.weights
        return {"action_error": error.sum(-1).mean() / self.weights.sum()}
