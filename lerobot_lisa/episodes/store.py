"""The episode store: every frame of a dataset in contiguous tensors, gathered by whole episodes.

LeRobot's loader reads 88 windows of 50 frames per CPU-second (docs/performance.md): frames pass through Python lists.
The policies therefore ask that loader for single frames only, and fetch from here the whole episodes that hold them.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import torch
from numpy.typing import NDArray
from torch import Tensor

from lerobot_lisa.errors import UserError
from lerobot_lisa.networks.packing import Packing


class Episodes(NamedTuple):
    """Whole episodes, one after another.

    Attributes:
        columns: Features of all N frames, each (N, *shape), in the dataset's own types.
        packing: Where each episode lies in the N frames.
    """

    columns: dict[str, Tensor]
    packing: Packing


class EpisodeStore:
    """All frames of a dataset, in episodes: runs of frames with one task.

    Args:
        columns: Features of every frame, each (frames, *shape).
        starts: First frame of each episode; together they share out all frames, in order.
        lengths: Frames of each episode.
        present: Whether an episode's frames are there; None: all are.
        sources: The dataset's episode that each is, or lies in; None: they are the dataset's.
        fetch: Called with episodes of the dataset before frames of theirs are read; None: everything is there.
    """

    def __init__(
        self,
        columns: Mapping[str, Tensor],
        starts: Sequence[int] | NDArray[Any],
        lengths: Sequence[int] | NDArray[Any],
        present: NDArray[Any] | None = None,
        sources: NDArray[Any] | None = None,
        fetch: Callable[[Sequence[int]], object] | None = None,
    ) -> None:
        self.columns = dict(columns)
        self.starts, self.lengths = torch.as_tensor(starts), torch.as_tensor(lengths)
        self.present = torch.ones(len(self.starts), dtype=torch.bool) if present is None else torch.as_tensor(present)
        self.sources = torch.arange(len(self.starts)) if sources is None else torch.as_tensor(sources)
        self._fetch = fetch

    def holding(self, frames: Tensor) -> Tensor:
        """The episodes (B,) that hold frames (B,) of the dataset, numbered as in LeRobot's `index`."""
        return torch.searchsorted(self.starts, frames.cpu(), right=True) - 1

    def gather(self, episodes: Tensor, device: torch.device | str = "cpu") -> Episodes:
        """Fetch whole episodes.

        Args:
            episodes: (B,) episodes of the store, such as `holding` gives; repeats are allowed.
            device: Where the result goes.

        Returns:
            Their frames and where each episode lies among them.

        Raises:
            UserError: An episode is in a part of the dataset that has not been fetched.
        """
        chosen = episodes.cpu()
        self._make_ready(chosen)
        spans = [
            slice(start, start + length)
            for start, length in zip(self.starts[chosen].tolist(), self.lengths[chosen].tolist(), strict=True)
        ]
        gathered = {
            key: torch.cat([column[span] for span in spans]).to(device, non_blocking=True)
            for key, column in self.columns.items()
        }
        return Episodes(gathered, Packing(self.lengths[chosen], device))

    def frames(self, frames: Tensor, device: torch.device | str = "cpu") -> dict[str, Tensor]:
        """Features of single frames (N,) of the dataset, numbered as in LeRobot's `index`, each (N, *shape).

        Raises:
            UserError: One is in a part of the dataset that has not been fetched.
        """
        self._make_ready(self.holding(frames).unique())
        return {key: column[frames.to(column.device)].to(device) for key, column in self.columns.items()}

    def _make_ready(self, episodes: Tensor) -> None:
        if not self.present[episodes].all():
            absent = int(self.sources[episodes[~self.present[episodes]][0]])
            raise UserError(f"episode {absent} is not on disk: its data file has not been fetched with the others")
        if self._fetch is not None:
            self._fetch(self.sources[episodes].tolist())

    def to(self, device: torch.device | str) -> "EpisodeStore":
        """The same store with its frames on `device`, so that gathering copies nothing between host and device."""
        if self._fetch is not None:
            self._fetch(self.sources[self.present].tolist())
        return self._with({key: column.to(device) for key, column in self.columns.items()})

    def renamed(self, names: Mapping[str, str]) -> "EpisodeStore":
        """The same store with features under other names: `names` maps old ones to new ones."""
        return self._with({names.get(key, key): column for key, column in self.columns.items()})

    def _with(self, columns: Mapping[str, Tensor]) -> "EpisodeStore":
        arrays = (self.starts.numpy(), self.lengths.numpy(), self.present.numpy(), self.sources.numpy())
        return EpisodeStore(columns, *arrays, self._fetch)
