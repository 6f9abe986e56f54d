"""Grids of symbols through convolutions that an instruction modulates: BabyAI 1.1's eyes."""

from math import prod

import torch
import torch.nn.functional as F
from torch import Tensor, nn


class CellEmbedding(nn.Module):
    """One vector for each cell of a grid: the sum of its symbols' embeddings, the same wherever the cell is.

    Args:
        shape: Of the grid, channels last.
        symbols: How many different values a symbol can take.
        width: D.
    """

    offsets: Tensor

    def __init__(self, shape: tuple[int, int, int], symbols: int, width: int) -> None:
        super().__init__()
        self.shape, self.symbols = shape, symbols
        self.bag = nn.EmbeddingBag(shape[2] * symbols, width, mode="sum")
        self.register_buffer("offsets", torch.arange(shape[2]) * symbols, persistent=False)

    def forward(self, symbols: Tensor) -> Tensor:
        """(N, cells x channels) of any numeric dtype -> (N, D, columns, rows)."""
        rows = symbols.reshape(-1, self.shape[2]).long().clamp(0, self.symbols - 1) + self.offsets
        cells = self.bag(rows).view(-1, prod(self.shape[:2]), self.bag.embedding_dim)
        return cells.transpose(1, 2).unflatten(2, self.shape[:2])


class FilmBlock(nn.Module):
    """Two convolutions, scaled and shifted for each channel by what a sentence says (FiLM, arXiv:1709.07871)."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.first, self.first_norm = _convolution(width), nn.BatchNorm2d(width)
        self.second, self.second_norm = _convolution(width), nn.BatchNorm2d(width)
        self.scale, self.shift = nn.Linear(width, width), nn.Linear(width, width, bias=False)  # the norm has a bias

    def forward(self, cells: Tensor, sentences: Tensor) -> Tensor:
        """Maps (N, D, columns, rows) and a sentence (N, D) for each -> maps of the same shape."""
        cells = self.second(F.relu(self.first_norm(self.first(cells))))
        modulated = self.scale(sentences)[..., None, None] * cells + self.shift(sentences)[..., None, None]
        return F.relu(self.second_norm(modulated))


class FilmGridEncoder(nn.Module):
    """A grid and a sentence to one vector, as BabyAI 1.1 does it (arXiv:2007.12770).

    Cells are embedded, nothing is pooled before the end, and FiLM blocks have residual connections.

    Args:
        shape: Of the grid, channels last.
        symbols: How many different values a symbol can take.
        width: D.
        blocks: FiLM blocks.
    """

    def __init__(self, shape: tuple[int, int, int], symbols: int, width: int, blocks: int = 2) -> None:
        super().__init__()
        self.cells = CellEmbedding(shape, symbols, width)
        layers = [(_convolution(width), nn.BatchNorm2d(width), nn.ReLU()) for _ in range(2)]
        self.convolutions = nn.Sequential(*(part for layer in layers for part in layer))
        self.blocks = nn.ModuleList(FilmBlock(width) for _ in range(blocks))

    def forward(self, symbols: Tensor, sentences: Tensor) -> Tensor:
        """Symbols (N, cells x channels) and a sentence (N, D) for each -> (N, D)."""
        cells = self.convolutions(self.cells(symbols))
        for block in self.blocks:
            cells = cells + block(cells, sentences)
        return cells.amax((2, 3))


def _convolution(width: int) -> nn.Conv2d:
    return nn.Conv2d(width, width, 3, padding=1, bias=False)  # followed by a norm, which has a bias
