"""Cross-entropy method: a search for actions that draws plans, keeps the best ones, and draws around these again."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class CrossEntropySearch:
    """How plans are sought (Rubinstein and Kroese, 2004).

    Attributes:
        samples: Plans drawn in each round.
        elites: The best of them, around which the next round draws.
        rounds: How many there are.
    """

    samples: int
    elites: int
    rounds: int

    @torch.no_grad()
    def __call__(
        self,
        value: Callable[[Tensor], Tensor],
        bounds: Tensor,
        around: Tensor,
        generator: torch.Generator | None = None,
    ) -> Tensor:
        """Several searches side by side.

        Args:
            value: Of plans (B, samples, T, A), (B, samples); the greatest is best.
            bounds: (2, A) least and greatest action.
            around: Plans (B, T, A) of B searches, around which the first round draws.
            generator: What to draw from; None: torch's own.

        Returns:
            The best plan of the last round, (B, T, A). The mean of its elites is timid wherever several plans are good.
        """
        low, high = bounds
        mean, spread = around, ((high - low) / 2).expand_as(around)
        for _ in range(self.rounds):
            noise = torch.randn(len(around), self.samples, *mean.shape[1:], generator=generator, device=bounds.device)
            plans = torch.maximum(torch.minimum(mean[:, None] + spread[:, None] * noise, high), low)
            best = value(plans).topk(self.elites, dim=1).indices
            elites = plans[torch.arange(len(around), device=best.device)[:, None], best]
            mean, spread = elites.mean(1), elites.std(1, correction=0)
        return elites[:, 0]
