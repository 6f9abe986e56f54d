"""When something happened: learned timestep embeddings."""

from torch import Tensor, nn


class TimestepEmbedding(nn.Module):
    """One learned vector per step, counted from the episode's start.

    Rollouts may last longer than any training episode; steps beyond the last trained one share its vector.
    """

    def __init__(self, steps: int, width: int) -> None:
        super().__init__()
        self.embedding = nn.Embedding(steps, width)
        nn.init.normal_(self.embedding.weight, std=0.02)

    def forward(self, steps: Tensor) -> Tensor:
        """Steps (N,) -> (N, D)."""
        return self.embedding(steps.clamp(max=self.embedding.num_embeddings - 1))
