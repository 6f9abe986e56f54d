"""Bot demonstrations of a level as a LeRobot dataset: in parallel, resumable, the same bytes however it was made."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from dataset_converters.babyai.cards import generated_card
from dataset_converters.babyai.demonstration import Demonstration
from dataset_converters.babyai.schema import babyai_layout, to_episodes
from dataset_converters.babyai.shards import load_shard, make_shard
from dataset_converters.card import write_card
from dataset_converters.seeds import FIRST_TRAINING_SEED, SeedRange, check_run, split_seeds
from dataset_converters.shard_files import shard_path
from dataset_converters.staging import staged
from dataset_converters.workers import progress, results_in_order, worker_pool
from dataset_converters.writer import DatasetTotals, write_dataset
from lerobot_lisa.envs.babyai.levels import check_level
from lerobot_lisa.errors import UserError

_SEEDS_PER_SHARD = 50
_HOPELESS = 1000  # this many failures without any success: the bot cannot solve the level


@dataclass(frozen=True)
class GenerateSettings:
    """What to generate."""

    level: str
    episodes: int
    root: Path
    repo_id: str
    first_seed: int = FIRST_TRAINING_SEED
    workers: int = 1
    subtasks: bool = False  # whether the parts of instructions are stored that the bot serves


@dataclass(frozen=True)
class GenerateResult:
    """What was generated."""

    totals: DatasetTotals
    seeds: list[int]  # of its episodes; those between that are missing failed


def generate(settings: GenerateSettings) -> GenerateResult:
    """Generate a dataset of the first `episodes` successes of the bot, counting seeds up from `first_seed`.

    An interrupted run leaves its shards in `<root>.partial`; the same settings (the number of episodes and of workers
    may differ) continue from there and end with the same bytes.

    Raises:
        UserError: for an unknown level, a seed or a number out of range, or an output that cannot be written.
    """
    level = check_level(settings.level)
    check_run(settings.episodes, settings.workers, settings.first_seed)
    described = {"level": level, "first_seed": settings.first_seed, "seeds_per_shard": _SEEDS_PER_SHARD}
    if settings.subtasks:
        described["subtasks"] = True
    with staged(settings.root, described) as partial:
        shards = partial / "shards"
        shards.mkdir(exist_ok=True)
        ranges = _fill_shards(shards, level, settings)
        seeds: list[int] = []
        demonstrations = _first_successes(shards, level, ranges, settings.episodes, seeds)
        with progress(demonstrations, settings.episodes, "writing") as bar:
            layout = babyai_layout(settings.repo_id, settings.subtasks)
            totals = write_dataset(partial / "dataset", layout, to_episodes((demo, None) for demo in bar))
        card = generated_card(level, settings.first_seed, seeds, settings.subtasks)
        write_card(partial / "dataset", settings.repo_id, card)
    return GenerateResult(totals, seeds)


def generate_range(level: str, seeds: SeedRange, root: Path, repo_id: str) -> DatasetTotals:
    """Generate a dataset of every success of the bot in a range of seeds, one part of a larger dataset, without a card.

    An interrupted run leaves its shards in `<root>.partial`, and the same arguments continue from there.

    Raises:
        UserError: for an unknown level, or an output that cannot be written.
    """
    level = check_level(level)
    with staged(root, {"level": level, "first_seed": seeds.first, "stop": seeds.stop}) as partial:
        shards = partial / "shards"
        shards.mkdir(exist_ok=True)
        parts = split_seeds(seeds, _SEEDS_PER_SHARD)
        for part in parts:
            make_shard(shards, level, part)
        demonstrations = (demo for part in parts for demo in load_shard(shard_path(shards, part), level))
        layout = babyai_layout(repo_id)
        return write_dataset(partial / "dataset", layout, to_episodes((demo, None) for demo in demonstrations))


def _fill_shards(shards: Path, level: str, settings: GenerateSettings) -> list[SeedRange]:
    """Make shards until they hold enough successes; later ones only make up for failures in earlier ones."""
    ranges: list[SeedRange] = []
    successes = failures = 0
    next_seed = settings.first_seed
    with (
        worker_pool(settings.workers, [make_shard.__module__]) as pool,
        progress(None, settings.episodes, f"demonstrating {level}") as bar,
    ):
        while successes < settings.episodes:
            batch = split_seeds(SeedRange(next_seed, next_seed + settings.episodes - successes), _SEEDS_PER_SHARD)
            calls = ((shards, level, seeds) for seeds in batch)
            for counts in results_in_order(pool, make_shard, calls, ahead=2 * settings.workers):
                successes, failures = successes + counts.successes, failures + counts.failures
                bar.update(counts.successes)
                bar.set_postfix(failures=failures)
                if not successes and failures >= _HOPELESS:
                    raise UserError(f"the bot failed all of its first {failures} episodes of {level}; choose another")
            ranges += batch
            next_seed = batch[-1].stop
    return ranges


def _first_successes(
    shards: Path, level: str, ranges: list[SeedRange], count: int, seeds: list[int]
) -> Iterator[Demonstration]:
    """The first `count` demonstrations by seed; their seeds are appended to `seeds`."""
    for part in ranges:
        for demo in load_shard(shard_path(shards, part), level):
            if len(seeds) == count:
                return
            seeds.append(int(demo.seed or 0))
            yield demo
