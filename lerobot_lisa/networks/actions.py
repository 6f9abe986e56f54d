"""What an action head is, and the one for categorical actions: embedding, loss, how an action is picked."""

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
