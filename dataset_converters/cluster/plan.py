"""What a run on many machines makes: its shards, each a dataset of its own, and the merged dataset."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path

from dataset_converters.card import DatasetCard


@dataclass(frozen=True)
class Plan(ABC):
    """A dataset that is made in shards; a plan travels to other machines, so it holds plain values only.

    Attributes:
        root: Directory of the merged dataset, which all machines can write to.
        repo_id: Its name.
    """

    root: Path
    repo_id: str

    @property
    @abstractmethod
    def shards(self) -> int:
        """How many shards there are."""

    @abstractmethod
    def describe(self) -> dict[str, object]:
        """JSON values that must be the same for a run to go on with the shards of another."""

    @abstractmethod
    def make_shard(self, shard: int) -> None:
        """Make one shard at `shard_root(shard)`; does nothing if it is there, and goes on where it was interrupted."""

    def complete(self) -> list[Path]:
        """Make what is missing once all shards are there; returns the datasets to merge, in order."""
        return [self.shard_root(shard) for shard in range(self.shards)]

    @abstractmethod
    def card(self, roots: list[Path]) -> DatasetCard:
        """What the card of the merged dataset says."""

    @property
    def folder(self) -> Path:
        """Where shards and logs are kept until the dataset is complete."""
        return self.root.with_name(self.root.name + ".shards")

    @property
    def logs(self) -> Path:
        """Where datatrove notes which shards are done."""
        return self.folder / "logs"

    def shard_root(self, shard: int) -> Path:
        """Directory of one shard."""
        return self.folder / f"{shard:05d}"
