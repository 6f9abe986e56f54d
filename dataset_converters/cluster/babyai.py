"""BabyAI in shards: bot demonstrations by ranges of seeds, original files one by one."""

from dataclasses import dataclass
from pathlib import Path

import pyarrow.parquet as pq
from lerobot.datasets.io_utils import load_info

from dataset_converters.babyai.cards import converted_card, generated_card
from dataset_converters.babyai.convert import ConvertSettings, convert
from dataset_converters.babyai.generate import generate_range
from dataset_converters.card import DatasetCard
from dataset_converters.cluster.plan import Plan
from dataset_converters.seeds import FIRST_TRAINING_SEED, SeedRange


@dataclass(frozen=True)
class GeneratePlan(Plan):
    """The first `episodes` successes of the bot, counting seeds up from `first_seed`, `per_shard` seeds to a shard."""

    level: str
    episodes: int
    per_shard: int
    first_seed: int = FIRST_TRAINING_SEED

    @property
    def shards(self) -> int:
        """Ranges of seeds; the last one may be shorter."""
        return -(-self.episodes // self.per_shard)

    def describe(self) -> dict[str, object]:
        """The number of episodes is no part: another one goes on with the shards that are there."""
        return {"level": self.level, "first_seed": self.first_seed, "per_shard": self.per_shard}

    def seeds(self, shard: int) -> SeedRange:
        """Seeds of one shard."""
        start = shard * self.per_shard
        return SeedRange(self.first_seed + start, self.first_seed + min(start + self.per_shard, self.episodes))

    def make_shard(self, shard: int) -> None:
        """Demonstrate every seed of the shard and keep the successes."""
        self._make(self.shard_root(shard), self.seeds(shard))

    def complete(self) -> list[Path]:
        """Make up for failures with the seeds that follow, as `generate` does."""
        roots = super().complete()
        next_seed = self.first_seed + self.episodes
        while missing := self.episodes - sum(load_info(root).total_episodes for root in roots):
            seeds = SeedRange(next_seed, next_seed + missing)
            roots.append(self.folder / f"{seeds.first}-{seeds.stop}")
            self._make(roots[-1], seeds)
            next_seed = seeds.stop
        return roots

    def _make(self, root: Path, seeds: SeedRange) -> None:
        if not root.exists():
            generate_range(self.level, seeds, root, self.repo_id)

    def card(self, roots: list[Path]) -> DatasetCard:
        """The card that `generate` writes."""
        files = (file for root in roots for file in sorted(root.glob("meta/episodes/**/*.parquet")))
        seeds = [seed for file in files for seed in pq.read_table(file, columns=["seed"])["seed"].to_pylist()]
        return generated_card(self.level, self.first_seed, seeds)


@dataclass(frozen=True)
class ConvertPlan(Plan):
    """Files of the original package, all of one level; each is a shard."""

    level: str
    sources: tuple[Path, ...]

    @property
    def shards(self) -> int:
        """One for each file."""
        return len(self.sources)

    def describe(self) -> dict[str, object]:
        """Level and files."""
        return {"level": self.level, "sources": [str(source) for source in self.sources]}

    def make_shard(self, shard: int) -> None:
        """Convert one file."""
        root = self.shard_root(shard)
        if not root.exists():
            convert(ConvertSettings(self.sources[shard], root, self.repo_id, self.level))

    def card(self, roots: list[Path]) -> DatasetCard:
        """The card that `convert` writes, with all files in it."""
        names = ", ".join(source.name for source in self.sources)
        return converted_card(self.level, Path(names), "all demonstrations", "detected, rewritten as minigrid's")
