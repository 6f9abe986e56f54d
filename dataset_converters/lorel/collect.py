"""Random play in our simulator as a data set: in parallel, resumable, the same bytes however it was made."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from dataset_converters.card import write_card
from dataset_converters.lorel.cards import collected_card
from dataset_converters.lorel.episode import LorelEpisode
from dataset_converters.lorel.original_writer import write_original
from dataset_converters.lorel.random_play import scene_digest
from dataset_converters.lorel.schema import lorel_layout, to_episodes
from dataset_converters.lorel.shards import close_cameras, load_episodes, make_images, make_states
from dataset_converters.seeds import FIRST_TRAINING_SEED, SeedRange, check_run, split_seeds
from dataset_converters.staging import staged
from dataset_converters.workers import progress, results_in_order, worker_pool
from dataset_converters.writer import DatasetTotals, write_dataset
from lerobot_lisa.envs.gl import choose_gl
from lerobot_lisa.envs.lorel.camera import check_quality
from lerobot_lisa.envs.lorel.scene import check_arm, engine

_SEEDS_PER_SHARD = 25


class Format(StrEnum):
    """What is written: a LeRobot dataset, or the layout of the original data set."""

    LEROBOT = "lerobot"
    HDF5 = "hdf5"


@dataclass(frozen=True)
class CollectSettings:
    """What to collect.

    Attributes:
        episodes: number of episodes to play, one per seed.
        root: directory to create.
        repo_id: name of the dataset.
        quality: of the images; None: no images.
        format: what to write.
        keep_unlabelled: keep episodes in which nothing happened; the original layout always does.
        arm: variant of the simulated arm.
        first_seed: of the seeds to count up from.
        workers: number of processes.
    """

    episodes: int
    root: Path
    repo_id: str
    quality: str | None = None
    format: Format = Format.LEROBOT
    keep_unlabelled: bool = False
    arm: str = "original"
    first_seed: int = FIRST_TRAINING_SEED
    workers: int = 1

    @property
    def seeds(self) -> SeedRange:
        """One for each episode."""
        return SeedRange(self.first_seed, self.first_seed + self.episodes)

    @property
    def keeps_all(self) -> bool:
        """Whether every episode is written."""
        return self.keep_unlabelled or self.format is Format.HDF5


@dataclass(frozen=True)
class CollectResult:
    """What was collected."""

    totals: DatasetTotals
    dropped: int  # episodes in which nothing happened


def collect(settings: CollectSettings) -> CollectResult:
    """Play episodes at random, label them, render them if asked to, and write them.

    An interrupted run leaves its shards in `<root>.partial`; the same settings (the number of episodes and of workers
    may differ) continue from there and end with the same bytes.

    Raises:
        UserError: for settings out of range, a machine that cannot simulate or draw, or an output that cannot be
            written.
    """
    check_run(settings.episodes, settings.workers, settings.first_seed)
    check_arm(settings.arm)
    if settings.quality is not None:
        check_quality(settings.quality)
    with staged(settings.root, _described(settings)) as partial:
        shards = partial / "shards"
        shards.mkdir(exist_ok=True)
        ranges = split_seeds(settings.seeds, _SEEDS_PER_SHARD)
        _fill_shards(shards, ranges, settings)
        totals = _write(partial / "dataset", settings, _episodes(shards, ranges, settings))
        dropped = settings.episodes - totals.episodes
        if settings.format is Format.LEROBOT:
            seeds = f"{settings.seeds.first} to {settings.seeds.stop - 1}, one episode each"
            card = collected_card(seeds, engine(), settings.arm, settings.quality, dropped)
            write_card(partial / "dataset", settings.repo_id, card)
    return CollectResult(totals, dropped)


def _described(settings: CollectSettings) -> dict[str, object]:
    """What shards depend on."""
    described: dict[str, object] = {
        "arm": settings.arm,
        "engine": engine(),
        "first_seed": settings.first_seed,
        "quality": settings.quality,
        "scene": scene_digest(settings.arm),
        "seeds_per_shard": _SEEDS_PER_SHARD,
    }
    if settings.quality is not None:
        described |= {"renderer": choose_gl(), "renders_all": settings.keeps_all}
    return described


def _fill_shards(shards: Path, ranges: list[SeedRange], settings: CollectSettings) -> None:
    """Make all states first: they are cheap, and enough to render from at any time."""
    states = [(shards, settings.arm, seeds) for seeds in ranges]
    images = [(shards, settings.quality, settings.keeps_all, seeds) for seeds in ranges]
    with worker_pool(settings.workers, [make_states.__module__]) as pool:
        stages: list[tuple[str, Callable[..., int], list[tuple]]] = [("simulating", make_states, states)]
        if settings.quality is not None:
            stages.append(("rendering", make_images, images))
        try:
            for name, work, calls in stages:
                with progress(None, settings.episodes, name) as bar:
                    for count in results_in_order(pool, work, calls, ahead=2 * settings.workers):
                        bar.update(count)
        finally:
            close_cameras()


def _episodes(shards: Path, ranges: list[SeedRange], settings: CollectSettings) -> Iterator[LorelEpisode]:
    for seeds in ranges:
        yield from load_episodes(shards, seeds, settings.keeps_all, images=settings.quality is not None)


def _write(folder: Path, settings: CollectSettings, episodes: Iterator[LorelEpisode]) -> DatasetTotals:
    with progress(episodes, settings.episodes, "writing") as bar:
        if settings.format is Format.HDF5:
            return write_original(folder, settings.episodes, bar, settings.quality, engine())
        layout = lorel_layout(settings.repo_id, settings.quality, settings.arm)
        return write_dataset(folder, layout, to_episodes(bar))
