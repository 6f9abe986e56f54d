"""A model of the world: from what was seen so far and what is done from now on, what will be seen."""

import torch
import torch.nn.functional as F
from torch import Tensor, nn


class WorldModel(nn.Module):
    """A recurrent network: what a state does not show, such as where an arm is being led, follows from what was done.

    Imagined states are not fed back. Every step gets the last state that was seen, and says how the next one differs
    from the one before; so errors do not feed on themselves, and T steps are one call.

    Args:
        size: S, numbers of a state.
        actions: A, numbers of an action.
        width: D.
        dropout: Before the last layer.
    """

    def __init__(self, size: int, actions: int, width: int, dropout: float) -> None:
        super().__init__()
        self.memory = nn.GRU(size + 1 + actions, width, batch_first=True)
        hidden = [nn.Linear(width + size, width), nn.ReLU(), nn.Dropout(dropout)]
        self.change = nn.Sequential(*hidden, nn.Linear(width, size))

    def forward(
        self, states: Tensor, actions: Tensor, last_seen: Tensor, memory: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """Imagine what follows T steps.

        Args:
            states: (B, T, S); those after the last one that is seen are not looked at.
            actions: (B, T, A).
            last_seen: (B,) which of the T steps this is.
            memory: Of what came before, (1, B, D); None: nothing did.

        Returns:
            The states (B, T, S) that follow each step, and the memory (1, B, D) after all of them.
        """
        steps = torch.arange(states.shape[1], device=states.device)
        looked = torch.minimum(steps, last_seen[:, None])[..., None].expand_as(states)
        seen, fresh = states.gather(1, looked), (steps <= last_seen[:, None])[..., None].to(states.dtype)
        hidden, memory = self.memory(torch.cat([seen, fresh, actions], dim=-1), memory)
        so_far = self.change(torch.cat([hidden, seen], dim=-1)).cumsum(1)
        when_seen = F.pad(so_far, (0, 0, 1, 0)).gather(1, looked)
        return seen + so_far - when_seen, memory

    def imagine(self, states: Tensor, actions: Tensor, memory: Tensor | None) -> Tensor:
        """States (B, T, S) that follow states (B, S) under T actions (B, T, A)."""
        from_here = states[:, None].expand(-1, actions.shape[1], -1)
        imagined: Tensor = self(from_here, actions, _first(states), memory)[0]
        return imagined

    def remember(self, states: Tensor, actions: Tensor, memory: Tensor | None) -> Tensor:
        """The memory (1, B, D) after one more step: states (B, S) were seen, actions (B, A) done."""
        remembered: Tensor = self(states[:, None], actions[:, None], _first(states), memory)[1]
        return remembered


def _first(states: Tensor) -> Tensor:
    return torch.zeros(len(states), dtype=torch.int64, device=states.device)
