"""LOReL in shards: random play by ranges of seeds."""

import dataclasses
from dataclasses import dataclass
from pathlib import Path

from lerobot.datasets.io_utils import load_info

from dataset_converters.card import DatasetCard
from dataset_converters.cluster.plan import Plan
from dataset_converters.lorel.cards import collected_card
from dataset_converters.lorel.collect import CollectSettings, collect
from lerobot_lisa.envs.lorel.scene import engine


@dataclass(frozen=True)
class CollectPlan(Plan):
    """Random play, `per_shard` episodes to a shard; `settings` says what, its root and its workers are not used."""

    settings: CollectSettings
    per_shard: int

    @property
    def shards(self) -> int:
        """Ranges of seeds; the last one may be shorter."""
        return -(-self.settings.episodes // self.per_shard)

    def describe(self) -> dict[str, object]:
        """Everything that decides what is collected."""
        settings = dataclasses.asdict(self.settings)
        return {key: str(value) for key, value in settings.items() if key not in ("root", "workers")} | {
            "per_shard": self.per_shard
        }

    def make_shard(self, shard: int) -> None:
        """Collect the episodes of one range of seeds."""
        root, start = self.shard_root(shard), shard * self.per_shard
        if not root.exists():
            episodes = min(self.per_shard, self.settings.episodes - start)
            first_seed = self.settings.first_seed + start
            collect(dataclasses.replace(self.settings, root=root, episodes=episodes, first_seed=first_seed, workers=1))

    def card(self, roots: list[Path]) -> DatasetCard:
        """The card that `collect` writes."""
        settings = self.settings
        dropped = settings.episodes - sum(load_info(root).total_episodes for root in roots)
        seeds = f"{settings.seeds.first} to {settings.seeds.stop - 1}"
        return collected_card(seeds, engine(), settings.arm, settings.quality, dropped)
