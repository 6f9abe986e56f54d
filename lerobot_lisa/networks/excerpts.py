"""Parts of episodes that are learned from, each with the steps before it that are looked at but not learned from."""

from functools import cached_property

import torch
import torch.nn.functional as F
from torch import Tensor

from lerobot_lisa.networks.packing import Packing


class Excerpts(Packing):
    """Rows of B excerpts, one after another; an excerpt is some rows of context, then the rows that are learned from.

    Where whole episodes are too much, this is what a network gets instead of a `Packing` of them. Padded excerpts are
    aligned at the first row that is learned from, so that causal masks are the same for all of a batch.

    Attributes:
        lengths: (B,) rows of each excerpt, context and all.
        contexts: (B,) how many of them are context.
        first: (B,) the step of its episode at which the learned part of each excerpt begins.
        context_stride: Steps from one row of context to the next.
        stride: Steps from one row to the next from there on.
    """

    def __init__(
        self,
        lengths: Tensor,
        contexts: Tensor,
        first: Tensor,
        context_stride: int = 1,
        stride: int = 1,
        device: torch.device | str = "cpu",
    ) -> None:
        super().__init__(lengths, device)
        self.contexts, self.first = contexts.cpu(), first.cpu()
        self.context_stride, self.stride = context_stride, stride

    @cached_property
    def before(self) -> int:
        """Rows of padded excerpts that nothing is learned from."""
        return int(self.contexts.max())

    @cached_property
    def learned(self) -> Packing:
        """Where the learned parts lie among `learned_rows`."""
        return Packing(self.lengths - self.contexts, self.device)

    @cached_property
    def learned_rows(self) -> Tensor | None:
        """Rows (n,) that are learned from, of all N."""
        return (self._place >= 0).nonzero()[:, 0].to(self.device)

    @cached_property
    def longest(self) -> int:
        """Width of `pad`'s result."""
        return self.before + self.learned.longest

    @cached_property
    def steps(self) -> Tensor:
        """(N,) each row's step in its episode."""
        return self.steps_cpu.to(self.device)

    @cached_property
    def steps_cpu(self) -> Tensor:
        """The same on the CPU."""
        strides = torch.where(self._place < 0, self.context_stride, self.stride)
        return self.first[self.sequence_cpu] + self._place * strides

    @cached_property
    def valid(self) -> Tensor:
        """(B, longest) True where `pad` holds a real row."""
        place = self._padded_rows
        return ((place >= 0) & (place < self.lengths[:, None])).to(self.device)

    def pad(self, rows: Tensor) -> Tensor:
        """(N, D) -> (B, longest, D), aligned; what no row lies at is arbitrary."""
        starts = self.lengths.cumsum(0) - self.lengths
        index = (starts[:, None] + self._padded_rows).clamp(0, self.total - 1)
        return F.embedding(index.to(self.device), rows)

    def unpad(self, padded: Tensor) -> Tensor:
        """(B, T or more, D), from the first learned row on -> (n, D), rows that are learned from."""
        return self.learned.unpad(padded)

    def take(self, sequences: Tensor) -> "Excerpts":
        """Some excerpts (integers on the CPU), whose rows are `rows(sequences)`."""
        parts = (self.lengths[sequences], self.contexts[sequences], self.first[sequences])
        return Excerpts(*parts, self.context_stride, self.stride, self.device)

    @cached_property
    def _place(self) -> Tensor:
        """(N,) rows since the first one of its excerpt that is learned from; context is negative."""
        return self._steps_cpu - self.contexts[self.sequence_cpu]

    @cached_property
    def _padded_rows(self) -> Tensor:
        """(B, longest) the row of its own excerpt at each place of `pad`'s result; negative before its first."""
        return torch.arange(self.longest) - (self.before - self.contexts)[:, None]


def every(packing: Packing, stride: int) -> tuple[Tensor | None, Packing]:
    """Rows at steps that are multiples of `stride`, None if that is all of them, and where they lie.

    Context has no other steps already (see `cut`).
    """
    if stride == 1:
        return None, packing
    none = torch.zeros_like(packing.lengths)
    whole = packing if isinstance(packing, Excerpts) else Excerpts(packing.lengths, none, none, stride)
    rows = (whole.steps_cpu % stride == 0).nonzero()[:, 0]
    learned = (whole.learned.lengths + stride - 1) // stride
    looks = Excerpts(whole.contexts + learned, whole.contexts, whole.first, stride, stride, packing.device)
    return rows.to(packing.device), looks


def cut(
    lengths: Tensor, drawn: Tensor, learned: int, lookback: int, stride: int = 1, device: torch.device | str = "cpu"
) -> Excerpts:
    """Cut from each episode the part that holds a drawn step.

    Parts are the same wherever in them the drawn step is: 0 to `learned` - 1, `learned` to 2 * `learned` - 1, and so
    on. If every frame of a dataset is drawn equally often, and a part counts by the mean over its frames, then every
    frame counts the same: nothing is biased, neither towards short parts at the ends of episodes nor to their middles.

    Args:
        lengths: (B,) steps of the episodes.
        drawn: (B,) a step of each.
        learned: Steps of a part, a multiple of `stride`.
        lookback: Steps before a part that matter to what is predicted in it.
        stride: Which of them are looked at: 0, stride, 2 * stride, ...
        device: Where index tensors are made.
    """
    first = drawn // learned * learned
    contexts = torch.minimum(first, torch.tensor(lookback)) // stride
    rows = torch.minimum(lengths - first, torch.tensor(learned))
    return Excerpts(contexts + rows, contexts, first, stride, 1, device)
