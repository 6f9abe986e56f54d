"""The vector quantiser that turns the skill predictor's output into one of K skill codes, and its statistics."""

from abc import ABC, abstractmethod
from typing import NamedTuple

import torch
from torch import Tensor, nn
from vector_quantize_pytorch import VectorQuantize


class Quantized(NamedTuple):
    """Skills of N embeddings.

    Attributes:
        embeddings: (N, D), what the policy is conditioned on; gradients pass straight through to the input.
        codes: (N,) indices into the codebook; None without one.
        commitment: Scalar, mean squared distance between inputs and their codes, times the commitment weight.
        distances: (N, K) squared distances between projected inputs and codes, without gradient; None without codes.
    """

    embeddings: Tensor
    codes: Tensor | None
    commitment: Tensor
    distances: Tensor | None


class Skills(nn.Module, ABC):
    """What stands between the skill predictor and the policy."""

    @abstractmethod
    def forward(self, embeddings: Tensor) -> Quantized:
        """Skills of embeddings (N, D)."""

    @abstractmethod
    def embed(self, codes: Tensor) -> Tensor:
        """Embeddings (N, D) of codes (N,)."""


class ContinuousSkills(Skills):
    """An ablation of the paper (appendix, "Continuous skill codes"): as narrow as a code, but any numbers at all."""

    def __init__(self, width: int, code_width: int) -> None:
        super().__init__()
        self.narrow = nn.Sequential(nn.Linear(width, code_width), nn.LayerNorm(code_width))
        self.widen = nn.Linear(code_width, width)

    def forward(self, embeddings: Tensor) -> Quantized:
        """Through `code_width` numbers and back, (N, D) -> (N, D)."""
        return Quantized(self.widen(self.narrow(embeddings)), None, embeddings.new_zeros(()), None)

    def embed(self, codes: Tensor) -> Tensor:
        """There is no code to choose."""
        raise RuntimeError("continuous skills have no codes")


class Codebook(Skills):
    """K codes of `code_width` numbers, learned as moving averages of the embeddings they stand for.

    Paper, section 3.2: nearest code, exponential moving average (van den Oord et al., 2017), straight-through gradient.
    Initialised by k-means on the first batch, because codes drawn at random collapse to one within steps. A code that
    stands for fewer than `dead_code_threshold` embeddings of a batch, in the moving average, is put onto a random one.
    """

    def __init__(
        self,
        width: int,
        size: int,
        code_width: int,
        decay: float,
        commitment_weight: float,
        dead_code_threshold: float,
    ) -> None:
        super().__init__()
        self.size = size
        self.quantizer = VectorQuantize(
            dim=width,
            codebook_size=size,
            codebook_dim=code_width,
            decay=decay,
            commitment_weight=commitment_weight,
            kmeans_init=True,
            threshold_ema_dead_code=dead_code_threshold,
            layernorm_after_project_in=True,
            rotation_trick=False,  # the paper's gradient is straight-through; this costs seven times as much
        )

    def forward(self, embeddings: Tensor) -> Quantized:
        """Quantise real embeddings (N, D), padding left out. In training mode this also moves the codebook."""
        distances = self._distances(embeddings)
        if not (self.training or self.initialised):  # the library would take a rollout for the batch to start from
            codes = distances.argmin(-1)
            return Quantized(self.embed(codes), codes, embeddings.new_zeros(()), distances)
        quantized, codes, commitment = self.quantizer(embeddings[None])
        return Quantized(quantized[0], codes[0], commitment.sum(), distances)

    @property
    def initialised(self) -> bool:
        """Whether a training batch has placed the codes."""
        return bool(self.quantizer._codebook.initted)

    @torch.no_grad()
    def embed(self, codes: Tensor) -> Tensor:
        """Embeddings (N, D) of codes (N,): what the policy gets when a person chooses the code."""
        return self.quantizer.get_output_from_indices(codes)

    @torch.no_grad()
    def _distances(self, embeddings: Tensor) -> Tensor:
        projected = self.quantizer.project_in(embeddings).float()
        return torch.cdist(projected, self.quantizer.codebook.float()).square()


def mutual_information(distances: Tensor) -> Tensor:
    """Mutual information in bits between instructions and skill codes, as the paper's listing defines it.

    p(z | l) = softmax(-distance / 2); the result is H(mean p) - mean H(p).

    Args:
        distances: Squared distances (N, K) of N embeddings to K codes.
    """
    conditional = torch.softmax(-distances / 2, dim=-1)
    return _entropy(conditional.mean(0)) - _entropy(conditional).mean()


def perplexity(codes: Tensor, size: int) -> Tensor:
    """How many codes are in effective use: 2 to the entropy of their frequencies, between 1 and `size`."""
    return 2 ** _entropy(_counts(codes, size) / max(1, len(codes)))


def codes_used(codes: Tensor, size: int) -> Tensor:
    """How many different codes occur."""
    return (_counts(codes, size) > 0).sum()


def _counts(codes: Tensor, size: int) -> Tensor:
    """(K,) how often each code occurs; `bincount` and `unique` would make a GPU's host wait."""
    return torch.zeros(size, device=codes.device).index_add(0, codes, torch.ones(len(codes), device=codes.device))


def _entropy(probabilities: Tensor) -> Tensor:
    """In bits, over the last dimension; 0 log 0 is 0, which `xlogy` knows."""
    return -torch.special.xlogy(probabilities, probabilities).sum(-1) / torch.log(torch.tensor(2.0))
