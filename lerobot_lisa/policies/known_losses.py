"""Losses of held-out episodes: LeRobot asks for those of every frame, and each episode's is computed once."""

from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from typing import Any

import torch
from torch import Tensor, nn

Losses = tuple[Tensor, Tensor, dict[str, Tensor]]
"""Losses (B,), what else enters the loss of them all, and numbers worth logging."""


class KnownLosses:
    """What has been computed since the weights last changed.

    In `--dataset.eval_split` an episode of T frames is asked for T times: without this, that costs the square of T.
    """

    def __init__(self) -> None:
        self._known: dict[Hashable, tuple[Tensor, Tensor]] = {}
        self._state = 0

    def forget(self) -> None:
        """Compute everything anew."""
        self._known.clear()

    def look_up(self, keys: Sequence[Hashable], state: int, compute: Callable[[list[int]], Losses]) -> Losses:
        """Losses of B rows.

        Args:
            keys: (B,) what the loss of each depends on.
            state: Of the weights, see `state_of`.
            compute: Losses of some rows.
        """
        if state != self._state:
            self._known.clear()
            self._state = state
        rows = [row for row, key in enumerate(keys) if key not in self._known and key not in keys[:row]]
        metrics: dict[str, Tensor] = {}
        if rows:
            losses, extra, metrics = compute(rows)
            self._known |= {keys[row]: (loss, extra) for row, loss in zip(rows, losses, strict=True)}
        found, extras = zip(*(self._known[key] for key in keys), strict=True)
        return torch.stack(found), torch.stack(extras).mean(), metrics


def state_of(module: nn.Module) -> int:
    """Changes whenever weights or statistics are written to."""
    tensors: Iterable[Tensor] = (*module.parameters(), *module.buffers())
    return sum(tensor._version for tensor in tensors)


def rows_of(batch: Mapping[str, Any], rows: list[int]) -> dict[str, Any]:
    """Some rows of a batch."""
    count = len(batch["index"])
    return {key: _take(value, rows) if _has_rows(value, count) else value for key, value in batch.items()}


def _has_rows(value: Any, count: int) -> bool:
    return isinstance(value, list | Tensor) and getattr(value, "ndim", 1) > 0 and len(value) == count


def _take(value: Any, rows: list[int]) -> Any:
    return value[rows] if isinstance(value, Tensor) else [value[row] for row in rows]
