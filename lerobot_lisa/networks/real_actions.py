"""Heads for real-valued actions: the mean (the paper's), independent bins, or a mixture of Gaussians."""

from abc import abstractmethod

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from lerobot_lisa.networks.actions import ActionHead


class RealHead(ActionHead):
    """What heads for real-valued actions share.

    Args:
        width: D.
        weights: (A,) of each dimension in the loss; 0 for dimensions that the environment ignores, whose noise would
            drown the others.
        bounds: (2, A) least and greatest action of the demonstrations; picked actions stay within.
    """

    weights: Tensor
    bounds: Tensor

    def __init__(self, width: int, weights: Tensor, bounds: Tensor) -> None:
        super().__init__()
        self.embedding = nn.Linear(len(weights), width)
        self.register_buffer("weights", weights)
        self.register_buffer("bounds", bounds)

    def embed(self, actions: Tensor) -> Tensor:
        """(N, A) -> (N, D); ignored dimensions are not seen either."""
        return self.embedding(actions.float() * self.weights)

    def metrics(self, outputs: Tensor, actions: Tensor) -> dict[str, Tensor]:
        """Mean absolute error of the most probable action over the dimensions that count."""
        return {"action_error": self._average((self.most_probable(outputs) - actions).abs()).mean()}

    def pick(self, outputs: Tensor, generator: torch.Generator | None = None) -> Tensor:
        """Actions (N, A); dimensions that the environment ignores, about which nothing is learned, stay still."""
        still = self._within_bounds(torch.zeros_like(self.weights))
        return torch.where(self.weights > 0, self.draw(outputs, generator), still)

    @abstractmethod
    def draw(self, outputs: Tensor, generator: torch.Generator | None) -> Tensor:
        """Actions (N, A), with arbitrary numbers in ignored dimensions."""

    @abstractmethod
    def most_probable(self, outputs: Tensor) -> Tensor:
        """The action (N, A) that nothing random enters."""

    def _average(self, values: Tensor) -> Tensor:
        """Weighted mean over the action's dimensions: (N, A) -> (N,)."""
        return (values * self.weights).sum(-1) / self.weights.sum()

    def _within_bounds(self, actions: Tensor) -> Tensor:
        return torch.maximum(torch.minimum(actions, self.bounds[1]), self.bounds[0])


class MeanHead(RealHead):
    """Squared error, and the mean is taken (paper, section 3.2), times a factor.

    Demonstrations of random play have a mean near zero, and a policy that takes it hardly moves; a factor above 1 makes
    it move in the direction of the mean.
    """

    def __init__(self, width: int, weights: Tensor, bounds: Tensor, amplification: float = 1.0) -> None:
        super().__init__(width, weights, bounds)
        self.mean, self.amplification = nn.Linear(width, len(weights)), amplification

    def forward(self, hidden: Tensor) -> Tensor:
        """(N, D) -> mean action (N, A)."""
        return self.mean(hidden)

    def loss(self, outputs: Tensor, actions: Tensor) -> Tensor:
        """Squared error averaged over the dimensions that count, (N,)."""
        return self._average((outputs.float() - actions.float()).square())

    def most_probable(self, outputs: Tensor) -> Tensor:
        """The mean, (N, A)."""
        return outputs

    def draw(self, outputs: Tensor, generator: torch.Generator | None) -> Tensor:
        """The mean (N, A), amplified."""
        return outputs if self.amplification == 1 else self._within_bounds(outputs * self.amplification)


class BinsHead(RealHead):
    """Each dimension is one of several bins between its bounds: cross-entropy, and a bin's centre is taken.

    Args:
        width: D.
        weights: See `RealHead`.
        bounds: See `RealHead`.
        bins: For each dimension, of equal width.
        temperature: Of the softmax that bins are drawn from; 0 takes the most probable one.
    """

    def __init__(self, width: int, weights: Tensor, bounds: Tensor, bins: int, temperature: float) -> None:
        super().__init__(width, weights, bounds)
        self.bins, self.temperature = bins, temperature
        self.logits = nn.Linear(width, len(weights) * bins)

    def forward(self, hidden: Tensor) -> Tensor:
        """(N, D) -> logits (N, A, bins)."""
        return self.logits(hidden).unflatten(-1, (-1, self.bins))

    def loss(self, outputs: Tensor, actions: Tensor) -> Tensor:
        """Cross-entropy in nats, averaged over the dimensions that count, (N,)."""
        low, high = self.bounds
        place = (actions.float() - low) / (high - low).clamp(min=1e-6) * self.bins
        target = place.long().clamp(0, self.bins - 1)
        return self._average(F.cross_entropy(outputs.float().transpose(1, 2), target, reduction="none"))

    def most_probable(self, outputs: Tensor) -> Tensor:
        """Centres (N, A) of the most probable bins."""
        return self._centres(outputs.argmax(-1))

    def draw(self, outputs: Tensor, generator: torch.Generator | None) -> Tensor:
        """Centres (N, A) of bins, each dimension for itself."""
        if self.temperature == 0:
            return self.most_probable(outputs)
        probabilities = torch.softmax(outputs.float() / self.temperature, dim=-1)
        drawn = torch.multinomial(probabilities.flatten(0, 1), 1, generator=generator)
        return self._centres(drawn.view(outputs.shape[:2]))

    def _centres(self, bins: Tensor) -> Tensor:
        low, high = self.bounds
        return low + (bins + 0.5) / self.bins * (high - low)


class MixtureHead(RealHead):
    """A mixture of Gaussians with diagonal covariances: likelihood, and a component's mean or a draw is taken.

    Args:
        width: D.
        weights: See `RealHead`.
        bounds: See `RealHead`.
        components: Of the mixture.
        temperature: Scales the spread of draws and flattens the choice of component; 0 takes the mean of the most
            probable component.
    """

    def __init__(self, width: int, weights: Tensor, bounds: Tensor, components: int, temperature: float) -> None:
        super().__init__(width, weights, bounds)
        self.components, self.temperature, self.size = components, temperature, len(weights)
        self.parameters_of = nn.Linear(width, components * (1 + 2 * self.size))

    def forward(self, hidden: Tensor) -> Tensor:
        """(N, D) -> (N, components, 1 + 2A): logit, means, logarithms of standard deviations."""
        return self.parameters_of(hidden).unflatten(-1, (self.components, -1))

    def loss(self, outputs: Tensor, actions: Tensor) -> Tensor:
        """Negative log-likelihood in nats per dimension that counts, (N,)."""
        logits, mean, log_std = self._split(outputs.float())
        standardised = (actions.float()[:, None] - mean) / log_std.exp()
        density = -0.5 * standardised.square() - log_std - 0.9189385332  # log sqrt(2 pi)
        joint = torch.log_softmax(logits, dim=-1) + (density * self.weights).sum(-1)
        return -torch.logsumexp(joint, dim=-1) / self.weights.sum()

    def most_probable(self, outputs: Tensor) -> Tensor:
        """Mean (N, A) of the most probable component."""
        logits, mean, _ = self._split(outputs)
        return mean[torch.arange(len(mean), device=mean.device), logits.argmax(-1)]

    def draw(self, outputs: Tensor, generator: torch.Generator | None) -> Tensor:
        """Actions (N, A) within the bounds."""
        if self.temperature == 0:
            return self._within_bounds(self.most_probable(outputs))
        logits, mean, log_std = self._split(outputs.float())
        component = torch.multinomial(torch.softmax(logits / self.temperature, -1), 1, generator=generator)[:, 0]
        rows = torch.arange(len(mean), device=mean.device)
        noise = torch.randn(mean[:, 0].shape, generator=generator, device=mean.device)
        return self._within_bounds(mean[rows, component] + self.temperature * log_std[rows, component].exp() * noise)

    def _split(self, outputs: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Logits (N, C), means (N, C, A) and log standard deviations (N, C, A), the latter kept within reason."""
        logits, mean, log_std = outputs.split([1, self.size, self.size], dim=-1)
        return logits[..., 0], mean, log_std.clamp(-5, 2)
