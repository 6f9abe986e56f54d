"""Skills by k-means on what is said and seen, in the places of LISA's skill predictor and codebook."""

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor, nn
from vector_quantize_pytorch.vector_quantize_pytorch import kmeans

from lerobot_lisa.networks.codebooks import far_samples
from lerobot_lisa.networks.language import Instruction
from lerobot_lisa.networks.observations import side_by_side
from lerobot_lisa.networks.parts import Seen
from lerobot_lisa.networks.quantizers import Quantized, Quantizer

ROUNDS = 50  # of k-means


class PlainNumbers(nn.Module):
    """Observations as they are: the numbers of all features side by side.

    Args:
        keys: The features.
    """

    def __init__(self, keys: Sequence[str]) -> None:
        super().__init__()
        self.keys = list(keys)

    def forward(self, observations: Mapping[str, Tensor], names: Tensor) -> Seen:
        """N frames, each feature (N, *shape), to (N, S)."""
        return Seen(side_by_side(observations, self.keys), None)


class WholeVectors(nn.Module):
    """Hands the quantiser vectors as one part each.

    Args:
        width: D + S.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        self.width = width

    def forward(self, answers: Tensor, instruction: Instruction, whole: bool) -> Tensor:
        """(C, D + S) -> (C, 1, D + S)."""
        return answers[:, None]


class KMeansCodes(Quantizer):
    """Codes that k-means has placed once; a skill is the centre of its cluster.

    Args:
        width: E.
        size: K.
    """

    centers: Tensor
    placed: Tensor

    def __init__(self, width: int, size: int) -> None:
        super().__init__()
        self.sizes = (size,)
        self.register_buffer("centers", torch.zeros(size, width))
        self.register_buffer("placed", torch.zeros((), dtype=torch.bool))

    @torch.no_grad()
    def place(self, vectors: Tensor) -> None:
        """Cluster vectors (n, E), from starting points that are far from one another, always in the same way."""
        with torch.random.fork_rng([vectors.device] if vectors.device.type == "cuda" else []):
            torch.manual_seed(0)
            centers, _ = kmeans(vectors[None].float(), self.sizes[0], ROUNDS, sample_fn=far_samples)
        self.centers.copy_(centers[0])
        self.placed.fill_(True)

    def forward(self, embeddings: Tensor) -> Quantized:
        """Nearest centres of embeddings (N, 1, E); as long as there are none, embeddings as they are."""
        nothing = embeddings.new_zeros(())
        if not self.initialised:
            return Quantized(embeddings, None, nothing, None)
        distances = torch.cdist(embeddings[:, 0].float(), self.centers).square()
        codes = distances.argmin(1)
        return Quantized(self.embed(codes), codes, nothing, distances)

    @property
    def initialised(self) -> bool:
        """Whether the data have been clustered."""
        return bool(self.placed)

    def embed(self, codes: Tensor) -> Tensor:
        """Centres of skill codes (N,)."""
        return self.centers[codes][:, None]
