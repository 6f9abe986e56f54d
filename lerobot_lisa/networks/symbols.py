"""Symbolic observations: grids and categories as a whole, and as cells that carry names."""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from lerobot_lisa.networks.parts import Parts, SharedKeys, Slots


@dataclass(frozen=True)
class SymbolNames:
    """What the symbols of a feature are called.

    Attributes:
        channels: For each channel of a cell and each symbol there, the number of its name; -1 for symbols without.
            The first channel says what is in the cell: one whose first symbol has no name is no part of what is seen.
        used: Whether keys are made of them; else they tell what belongs to a cell, and no more.
    """

    channels: tuple[tuple[int, ...], ...]
    used: bool = True


class SymbolEncoder(nn.Module):
    """Symbolic grids and categories as a whole: one embedding per (position, symbol), summed, then a residual MLP.

    The bag of embeddings is BabyAI 1.1's (arXiv:2007.12770): embedding symbols instead of treating them as numbers was
    one of its three gains. Positions keep their own tables, which stands in for that paper's convolutions at a
    hundredth of their cost on a CPU.
    """

    offsets: Tensor

    def __init__(self, positions: int, symbols: int, width: int) -> None:
        super().__init__()
        self.symbols = symbols
        self.bag = nn.EmbeddingBag(positions * symbols, width, mode="sum")
        nn.init.normal_(self.bag.weight, std=0.1)
        self.mlp = nn.Sequential(
            nn.LayerNorm(width), nn.Linear(width, 2 * width), nn.GELU(), nn.Linear(2 * width, width)
        )
        self.register_buffer("offsets", torch.arange(positions) * symbols, persistent=False)

    def forward(self, symbols: Tensor) -> Tensor:
        """(N, positions) of any numeric dtype -> (N, D). Symbols outside the vocabulary count as its last one."""
        rows = symbols.flatten(1).long().clamp(0, self.symbols - 1) + self.offsets
        summed = self.bag(rows)
        return summed + self.mlp(summed)


class SymbolParts(nn.Module):
    """The cells of a symbolic feature as parts.

    With names, parts are the cells that hold a thing with a name, one to four in a view of BabyAI, and a part's key
    starts as the sum of its names' vectors. Without, every cell is a part, and its key is learned.

    Args:
        cells: How many there are; the feature holds `cells` x channels symbols, channels last.
        symbols: How many different values a symbol can take.
        words: W.
        values: C.
        names: What the symbols are called; None: a cell is one symbol without a name.
        readiness: How readily a named part answers at first: minus the score that a question has to reach.
    """

    offsets: Tensor
    name: Tensor

    def __init__(
        self, cells: int, symbols: int, words: int, values: int, names: SymbolNames | None, readiness: float
    ) -> None:
        super().__init__()
        channels = len(names.channels) if names else 1
        self.symbols, self.channels, self.named = symbols, channels, names is not None and names.used
        self.keys, self.values = nn.Embedding(channels * symbols, words), nn.Embedding(channels * symbols, values)
        self.places = nn.Embedding(cells, values)
        for table in (self.values, self.places):
            nn.init.normal_(table.weight, std=0.5)
        if self.named:
            nn.init.zeros_(self.keys.weight)
        self.readiness = nn.Parameter(torch.tensor(readiness if self.named else 0.0))
        self.register_buffer("offsets", torch.arange(channels) * symbols, persistent=False)
        self.register_buffer("name", _name_rows(names, symbols), persistent=False)

    def forward(self, symbols: Tensor, names: Tensor) -> Parts:
        """Symbols (N, cells x channels) and vectors of all names (n, W) to parts."""
        cells = symbols.flatten(1).long().clamp(0, self.symbols - 1).unflatten(1, (-1, self.channels)) + self.offsets
        present = self.name[cells[..., 0]] > 0 if self.named else cells.new_ones(cells.shape[:2], dtype=torch.bool)
        rows, places, slots = cells[present], present.nonzero()[:, 1], Slots.of(present)
        vectors = self.keys.weight
        if self.named:
            vectors = vectors + torch.cat([names.new_zeros(1, names.shape[1]), names])[self.name]
        values = nn.functional.embedding_bag(rows, self.values.weight, mode="sum") + self.places(places)
        bias = slots.pad(self.readiness.expand(len(rows)), float("-inf"))
        return Parts((SharedKeys(vectors, rows, slots),), slots.pad(values), bias, slots.pad(places))


def _name_rows(names: SymbolNames | None, symbols: int) -> Tensor:
    """(channels * symbols,) 1 + the number of each symbol's name, 0 for none."""
    table = torch.zeros(max(1, len(names.channels) if names else 1), symbols, dtype=torch.int64)
    for channel, numbers in enumerate(names.channels if names else ()):
        table[channel, : len(numbers)] = torch.tensor(numbers, dtype=torch.int64)[:symbols] + 1
    return table.flatten()
