"""What stands between the skill predictor and the policy: makes skill codes, or lets skills through as they are."""

from abc import ABC, abstractmethod
from math import prod
from typing import NamedTuple

import torch
from torch import Tensor, nn
from vector_quantize_pytorch import FSQ


class Quantized(NamedTuple):
    """Skills of N embeddings.

    Attributes:
        embeddings: (N, parts, E), what the policy is conditioned on; gradients pass straight through to the input.
        codes: (N,) skill codes, 0..K-1; None if skills are continuous.
        commitment: Scalar, mean squared distance between inputs and their codes, times the commitment weight.
        distances: (N, K) squared distances between inputs and codes, without gradient; None where there are none.
    """

    embeddings: Tensor
    codes: Tensor | None
    commitment: Tensor
    distances: Tensor | None


class Quantizer(nn.Module, ABC):
    """Turns embeddings (N, parts, E) into skills.

    Attributes:
        sizes: How many codes each part has; a skill code is one number, its parts' codes in mixed radix. Empty if
            skills are continuous.
        frozen: Whether the codes stay as they are.
    """

    sizes: tuple[int, ...]
    frozen = False

    @abstractmethod
    def forward(self, embeddings: Tensor) -> Quantized:
        """Skills of real embeddings (N, parts, E), padding left out. In training mode this may move the codes."""

    @abstractmethod
    def embed(self, codes: Tensor) -> Tensor:
        """Embeddings (N, parts, E) of skill codes (N,): what the policy gets when a person chooses them."""

    @property
    def n_codes(self) -> int:
        """K; 0 if skills are continuous."""
        return prod(self.sizes) if self.sizes else 0

    @property
    def initialised(self) -> bool:
        """Whether codes have been placed."""
        return True

    def freeze(self) -> None:
        """From now on not one number of the codes moves, projections included; what they stand for still learns."""
        self.frozen = True
        self.requires_grad_(False)

    @property
    def makes_codes(self) -> bool:
        """Whether the next embeddings will get codes, or pass as they are."""
        return bool(self.sizes)

    @property
    def most_used(self) -> list[int]:
        """The code of each part that training used most, as far as the quantiser counts them; else the first."""
        return [0] * len(self.sizes)

    def split(self, codes: Tensor) -> Tensor:
        """Skill codes (N,) to codes of their parts (N, parts)."""
        parts = []
        for size in reversed(self.sizes):
            parts.append(codes % size)
            codes = codes // size
        return torch.stack(parts[::-1], dim=-1)

    def join(self, parts: Tensor) -> Tensor:
        """Codes of parts (N, parts) to skill codes (N,)."""
        codes = torch.zeros_like(parts[:, 0])
        for column, size in zip(parts.unbind(1), self.sizes, strict=True):
            codes = codes * size + column
        return codes


class Continuous(Quantizer):
    """No codes at all: an ablation of the paper (appendix, "Continuous skill codes").

    Args:
        width: E.
        code_width: Numbers that pass, layer-normalised; None: all of them, as they are.
    """

    sizes = ()

    def __init__(self, width: int, code_width: int | None) -> None:
        super().__init__()
        self.passage: nn.Module = nn.Identity()
        if code_width is not None:
            narrow = nn.Sequential(nn.Linear(width, code_width), nn.LayerNorm(code_width))
            self.passage = nn.Sequential(narrow, nn.Linear(code_width, width))

    def forward(self, embeddings: Tensor) -> Quantized:
        """Through `code_width` numbers and back, (N, parts, E)."""
        return Quantized(self.passage(embeddings), None, embeddings.new_zeros(()), None)

    def embed(self, codes: Tensor) -> Tensor:
        """There is no code to choose."""
        raise RuntimeError("continuous skills have no codes")


class FiniteScalars(Quantizer):
    """Finite scalar quantisation (arXiv:2309.15505): a few numbers, each rounded to one of a few levels."""

    def __init__(self, width: int, levels: list[int]) -> None:
        super().__init__()
        with torch.device("cpu"):  # the library counts codes as it is built, which nobody can on the meta device
            self.quantizer = FSQ(levels=levels, dim=width)
        self.sizes = (self.quantizer.codebook_size,)

    def forward(self, embeddings: Tensor) -> Quantized:
        """Codes of embeddings (N, 1, E)."""
        quantized, codes = self.quantizer(embeddings[:, 0][None])
        return Quantized(quantized[0][:, None], codes[0].long(), embeddings.new_zeros(()), None)

    @torch.no_grad()
    def embed(self, codes: Tensor) -> Tensor:
        """Embeddings of skill codes (N,)."""
        return self.quantizer.indices_to_codes(codes[None])[0][:, None]
