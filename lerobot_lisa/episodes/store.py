"""The episode store: every frame of a dataset in contiguous tensors, gathered by whole episodes.

LeRobot's loader reads about 65 windows of 50 frames per second and core: each frame passes through Python lists.
The policies therefore ask that loader for single frames only, and fetch whole episodes from here by episode index.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

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
    """All frames of a dataset.

    Args:
        columns: Features of every frame, each (frames, *shape).
        starts: First frame of each episode.
        lengths: Frames of each episode.
    """

    def __init__(self, columns: Mapping[str, Tensor], starts: Sequence[int], lengths: Sequence[int]) -> None:
        self.columns = dict(columns)
        self.starts, self.lengths = torch.as_tensor(starts), torch.as_tensor(lengths)

    def gather(self, episodes: Tensor, device: torch.device | str = "cpu") -> Episodes:
        """Fetch whole episodes.

        Args:
            episodes: (B,) episode indices; repeats are allowed.
            device: Where the result goes.

        Returns:
            Their frames and where each episode lies among them.
        """
        chosen = episodes.cpu()
        spans = [
            slice(start, start + length)
            for start, length in zip(self.starts[chosen].tolist(), self.lengths[chosen].tolist(), strict=True)
        ]
        gathered = {
            key: torch.cat([column[span] for span in spans]).to(device, non_blocking=True)
            for key, column in self.columns.items()
        }
        return Episodes(gathered, Packing(self.lengths[chosen], device))

    def to(self, device: torch.device | str) -> "EpisodeStore":
        """The same store with its frames on `device`, so that gathering copies nothing between host and device."""
        moved = {key: column.to(device) for key, column in self.columns.items()}
        return EpisodeStore(moved, self.starts.tolist(), self.lengths.tolist())
