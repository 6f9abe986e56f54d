"""Sequences of different lengths laid end to end, so that no encoder, quantiser or loss ever sees padding."""

from functools import cached_property

import torch
import torch.nn.functional as F
from torch import Tensor


class Packing:
    """Index arithmetic for B sequences of known lengths that lie one after another in a tensor of N rows.

    Attributes:
        lengths: (B,) integers on the CPU, all at least 1.
        device: Where index tensors are made.
    """

    def __init__(self, lengths: Tensor, device: torch.device | str = "cpu") -> None:
        self.lengths = lengths.cpu()
        self.device = torch.device(device)

    # What is learned from: here, all rows; `Excerpts` have some that are only looked at.

    @property
    def before(self) -> int:
        """Rows of each padded sequence, at its beginning, that nothing is learned from."""
        return 0

    @property
    def learned(self) -> "Packing":
        """Where sequences lie among the rows that are learned from."""
        return self

    @property
    def learned_rows(self) -> Tensor | None:
        """Rows that are learned from; None: all."""
        return None

    def take(self, sequences: Tensor) -> "Packing":
        """Some sequences (integers on the CPU), whose rows are `rows(sequences)`."""
        return Packing(self.lengths[sequences], self.device)

    @cached_property
    def total(self) -> int:
        """Number of rows N."""
        return int(self.lengths.sum())

    @cached_property
    def longest(self) -> int:
        """Length T of the longest sequence, the width of `pad`'s result."""
        return int(self.lengths.max())

    @cached_property
    def steps(self) -> Tensor:
        """(N,) each row's position in its own sequence."""
        return self.steps_cpu.to(self.device)

    @cached_property
    def steps_cpu(self) -> Tensor:
        """The same on the CPU."""
        return self._steps_cpu

    @cached_property
    def sequence(self) -> Tensor:
        """(N,) the number of the sequence that each row belongs to."""
        return self.sequence_cpu.to(self.device)

    @cached_property
    def valid(self) -> Tensor:
        """(B, T) True where `pad` holds a real row."""
        return (torch.arange(self.longest) < self.lengths[:, None]).to(self.device)

    def pad(self, rows: Tensor) -> Tensor:
        """(N, D) -> (B, T, D). What lies past a sequence's end is arbitrary: whoever reads this must mask it."""
        first = self.lengths.cumsum(0) - self.lengths
        index = first[:, None] + torch.arange(self.longest)
        return F.embedding(index.clamp(max=self.total - 1).to(self.device), rows)

    def unpad(self, padded: Tensor) -> Tensor:
        """(B, T or more, D) -> (N, D), the real rows only."""
        index = self.sequence_cpu * padded.shape[1] + self._steps_cpu
        return F.embedding(index.to(self.device), padded.flatten(0, 1))

    def rows(self, sequences: Tensor) -> Tensor:
        """Rows of some sequences (integers on the CPU), one sequence after another."""
        part = Packing(self.lengths[sequences])
        first = (self.lengths.cumsum(0) - self.lengths)[sequences]
        return (first[part.sequence] + part.steps).to(self.device)

    def mean(self, rows: Tensor) -> Tensor:
        """Mean over each sequence: (N, ...) -> (B, ...)."""
        sums = rows.new_zeros(len(self.lengths), *rows.shape[1:]).index_add(0, self.sequence, rows)
        return sums / self.lengths.to(self.device).view(-1, *[1] * (rows.ndim - 1))

    def split(self, horizon: int) -> "Packing":
        """The same rows as chunks of `horizon`, counted from each sequence's start; its last chunk may be shorter."""
        chunks = self.count_chunks(horizon).lengths
        lengths = torch.full((int(chunks.sum()),), horizon)
        lengths[chunks.cumsum(0) - 1] = (self.lengths - 1) % horizon + 1
        return Packing(lengths, self.device)

    def count_chunks(self, horizon: int) -> "Packing":
        """Chunks of `horizon` as rows: how many each sequence has, partial ones counted."""
        return Packing((self.lengths + horizon - 1) // horizon, self.device)

    @cached_property
    def sequence_cpu(self) -> Tensor:
        """`sequence` on the CPU."""
        return torch.repeat_interleave(torch.arange(len(self.lengths)), self.lengths)

    @cached_property
    def _steps_cpu(self) -> Tensor:
        return torch.arange(self.total) - (self.lengths.cumsum(0) - self.lengths)[self.sequence_cpu]


def by_length(lengths: Tensor, waste: float) -> list[Tensor]:
    """Group sequences of similar length, so that padding is at most `waste` of each group.

    Args:
        lengths: (B,) integers.
        waste: Share of padding allowed, 0 (equal lengths only) to 1 (one group).

    Returns:
        Index tensors that partition 0..B-1, shortest sequences first.
    """
    order = torch.argsort(lengths, stable=True)
    groups: list[Tensor] = []
    current: list[int] = []
    real = 0
    for index in order.tolist():
        length = int(lengths[index])
        if current and 1 - (real + length) / (length * (len(current) + 1)) > waste:
            groups.append(torch.tensor(current))
            current, real = [], 0
        current.append(index)
        real += length
    return [*groups, torch.tensor(current)]
