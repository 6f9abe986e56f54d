"""Bot demonstrations of a level as a LeRobot dataset: in parallel, resumable, the same bytes however it was made."""

import multiprocessing
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from tqdm import tqdm

from dataset_converters.babyai.cards import generated_card
from dataset_converters.babyai.demonstration import Demonstration
from dataset_converters.babyai.schema import babyai_layout, to_episodes
from dataset_converters.babyai.shards import SeedRange, ShardCounts, follow_parent, load_shard, make_shard, shard_path
from dataset_converters.card import write_card
from dataset_converters.staging import staged
from dataset_converters.writer import DatasetTotals, write_dataset
from lerobot_lisa.envs.babyai.levels import check_level
from lerobot_lisa.errors import UserError

FIRST_TRAINING_SEED = 1_000_000
"""Seeds below are reserved for evaluation, so that no evaluated episode can be in the training data."""

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


@dataclass(frozen=True)
class GenerateResult:
    """What was generated."""

    totals: DatasetTotals
    failures: int
    last_seed: int


def generate(settings: GenerateSettings) -> GenerateResult:
    """Generate a dataset of the first `episodes` successes of the bot, counting seeds up from `first_seed`.

    An interrupted run leaves its shards in `<root>.partial`; the same settings (the number of episodes and of workers
    may differ) continue from there and end with the same bytes.

    Raises:
        UserError: for an unknown level, a seed or a number out of range, or an output that cannot be written.
    """
    level = check_level(settings.level)
    _check_numbers(settings)
    described = {"level": level, "first_seed": settings.first_seed, "seeds_per_shard": _SEEDS_PER_SHARD}
    with staged(settings.root, described) as partial:
        shards = partial / "shards"
        shards.mkdir(exist_ok=True)
        ranges = _fill_shards(shards, level, settings)
        seeds: list[int] = []
        demonstrations = _first_successes(shards, level, ranges, settings.episodes, seeds)
        with tqdm(demonstrations, total=settings.episodes, desc="writing", unit="episode", disable=None) as progress:
            totals = write_dataset(
                partial / "dataset", babyai_layout(settings.repo_id), to_episodes((demo, None) for demo in progress)
            )
        failures = seeds[-1] - settings.first_seed + 1 - settings.episodes
        card = generated_card(level, settings.first_seed, seeds[-1], failures)
        write_card(partial / "dataset", settings.repo_id, card)
    return GenerateResult(totals, failures, seeds[-1])


def _check_numbers(settings: GenerateSettings) -> None:
    if settings.episodes < 1 or settings.workers < 1:
        raise UserError("--episodes and --workers must be at least 1")
    if settings.first_seed < FIRST_TRAINING_SEED:
        raise UserError(
            f"--first-seed {settings.first_seed} is reserved: seeds below {FIRST_TRAINING_SEED} are for evaluation, "
            f"so that no policy is trained on them; use {FIRST_TRAINING_SEED} or more"
        )


def _fill_shards(shards: Path, level: str, settings: GenerateSettings) -> list[SeedRange]:
    """Make shards until they hold enough successes; later ones only make up for failures in earlier ones."""
    ranges: list[SeedRange] = []
    successes = failures = 0
    next_seed = settings.first_seed
    with (
        _workers(settings.workers) as pool,
        tqdm(total=settings.episodes, desc=f"demonstrating {level}", unit="episode", disable=None) as progress,
    ):
        while successes < settings.episodes:
            batch = _split(SeedRange(next_seed, next_seed + settings.episodes - successes))
            for counts in _counts(pool, shards, level, batch, 2 * settings.workers):
                successes, failures = successes + counts.successes, failures + counts.failures
                progress.update(counts.successes)
                progress.set_postfix(failures=failures)
                if not successes and failures >= _HOPELESS:
                    raise UserError(f"the bot failed all of its first {failures} episodes of {level}; choose another")
            ranges += batch
            next_seed = batch[-1].stop
    return ranges


def _split(seeds: SeedRange) -> list[SeedRange]:
    starts = range(seeds.first, seeds.stop, _SEEDS_PER_SHARD)
    return [SeedRange(start, min(start + _SEEDS_PER_SHARD, seeds.stop)) for start in starts]


def _counts(
    pool: ProcessPoolExecutor | None, shards: Path, level: str, ranges: list[SeedRange], ahead: int
) -> Iterator[ShardCounts]:
    """Counts of each shard, in order, with at most `ahead` shards under way; without a pool, one after the other."""
    if pool is None:
        for seeds in ranges:
            yield make_shard(shards, level, seeds)
        return
    waiting: deque[Future[ShardCounts]] = deque()
    for seeds in ranges:
        waiting.append(pool.submit(make_shard, shards, level, seeds))
        if len(waiting) == ahead:
            yield waiting.popleft().result()
    while waiting:
        yield waiting.popleft().result()


@contextmanager
def _workers(count: int) -> Iterator[ProcessPoolExecutor | None]:
    """Worker processes; an interruption waits for the shards under way (seconds each), which are then kept."""
    if count == 1:
        yield None
        return
    method = "forkserver" if "forkserver" in multiprocessing.get_all_start_methods() else "spawn"
    context = multiprocessing.get_context(method)
    context.set_forkserver_preload([make_shard.__module__])  # imported once, not once per worker
    pool = ProcessPoolExecutor(count, context, initializer=follow_parent)
    try:
        yield pool
    except BrokenProcessPool as error:
        raise UserError(
            "a worker process was killed (out of memory?); run the same command again with fewer --workers"
        ) from error
    finally:
        pool.shutdown(cancel_futures=True)


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
