"""Demonstrations of Meta-World tasks as a data set: in parallel, resumable, the same bytes however it was made."""

from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from dataset_converters.card import write_card
from dataset_converters.metaworld.cards import collected_card
from dataset_converters.metaworld.expert import MetaworldEpisode, engine
from dataset_converters.metaworld.schema import metaworld_layout, to_episodes
from dataset_converters.metaworld.shards import Shard, load_episodes, make_pictures, make_states
from dataset_converters.seeds import FIRST_TRAINING_SEED, SeedRange, check_run, split_seeds
from dataset_converters.staging import staged
from dataset_converters.workers import progress, results_in_order, worker_pool
from dataset_converters.writer import DatasetTotals, write_dataset
from lerobot_lisa.envs.engine import check_drawing
from lerobot_lisa.envs.gl import choose_gl
from lerobot_lisa.envs.options import whole_number
from lerobot_lisa.errors import UserError

_SEEDS_PER_SHARD = 5  # at 480 pixels without a GPU drawing one takes a minute, which is what an interruption costs
_HOPELESS = 50  # this many failures of an expert without any success


@dataclass(frozen=True)
class CollectSettings:
    """What to collect.

    Attributes:
        tasks: names of tasks.
        episodes: successful ones to keep of each task.
        root: directory to create.
        repo_id: name of the dataset.
        pictures: whether to draw any.
        image_size: pixels along each side of pictures; None: as the environment draws them.
        first_seed: of the seeds to count up from, in each task.
        workers: number of processes.
    """

    tasks: tuple[str, ...]
    episodes: int
    root: Path
    repo_id: str
    pictures: bool = True
    image_size: int | None = None
    first_seed: int = FIRST_TRAINING_SEED
    workers: int = 1


@dataclass(frozen=True)
class CollectResult:
    """What was collected."""

    totals: DatasetTotals
    seeds: dict[str, list[int]]  # of the episodes of each task; those between that are missing failed
    first_seed: int

    @property
    def failures(self) -> int:
        """How often an expert failed before the last episode that was kept of its task."""
        return sum(seeds[-1] - self.first_seed + 1 - len(seeds) for seeds in self.seeds.values())


def collect(settings: CollectSettings) -> CollectResult:
    """Let experts demonstrate, draw what the environment shows if asked to, and write the first successes of each task.

    Episodes of the tasks alternate, so that the first N times as many as there are tasks are N of each. An interrupted
    run leaves its shards in `<root>.partial`; the same settings (tasks and the numbers of episodes and of workers may
    differ) continue from there and end with the same bytes.

    Raises:
        UserError: for settings out of range, a machine that cannot draw, an expert that fails, or an output that
            cannot be written.
    """
    check_run(settings.episodes, settings.workers, settings.first_seed)
    layout = metaworld_layout(settings.repo_id, settings.pictures, settings.image_size)
    _check_size(settings.image_size)
    if settings.pictures:
        check_drawing("Meta-World", "--states-only")
    with staged(settings.root, _described(settings)) as partial:
        shards = partial / "shards"
        shards.mkdir(exist_ok=True)
        made = _fill_shards(shards, settings)
        seeds: dict[str, list[int]] = {task: [] for task in settings.tasks}
        total = settings.episodes * len(settings.tasks)
        with progress(_alternating(shards, made, settings, seeds), total, "writing") as bar:
            totals = write_dataset(partial / "dataset", layout, to_episodes(bar))
        card = collected_card(seeds, settings.first_seed, _pictures(settings))
        write_card(partial / "dataset", settings.repo_id, card)
    return CollectResult(totals, seeds, settings.first_seed)


def _check_size(image_size: int | None) -> None:
    if image_size is not None:
        largest = metaworld_layout("", pictures=True).features["observation.image"]["shape"][0]
        whole_number(image_size, 16, largest, f"--image-size {image_size}")


def _pictures(settings: CollectSettings) -> str:
    if not settings.pictures:
        return "none"
    smaller = f", made smaller to {settings.image_size} x {settings.image_size} pixels" if settings.image_size else ""
    return f"what the environment shows{smaller}, drawn with {choose_gl() or 'the default of MuJoCo'}"


def _described(settings: CollectSettings) -> dict[str, object]:
    """What shards depend on."""
    described: dict[str, object] = {
        "engine": engine(),
        "first_seed": settings.first_seed,
        "seeds_per_shard": _SEEDS_PER_SHARD,
        "pictures": settings.pictures,
    }
    if settings.pictures:
        described |= {"renderer": choose_gl(), "image_size": settings.image_size}
    return described


def _fill_shards(folder: Path, settings: CollectSettings) -> dict[str, list[Shard]]:
    """Make the states of all tasks first: they are cheap, and tell what is worth drawing."""
    with worker_pool(settings.workers, [make_states.__module__]) as pool:
        made = {}
        with progress(None, settings.episodes * len(settings.tasks), "demonstrating") as bar:
            for task in settings.tasks:
                made[task] = _fill_states(folder, task, settings, pool, bar.update)
        if settings.pictures:
            calls = [(folder, settings.image_size, shard) for shards in made.values() for shard in shards]
            with progress(None, None, "drawing") as bar:
                for count in results_in_order(pool, make_pictures, calls, ahead=2 * settings.workers):
                    bar.update(count)
    return made


def _fill_states(
    folder: Path,
    task: str,
    settings: CollectSettings,
    pool: ProcessPoolExecutor | None,
    count: Callable[[int], object],
) -> list[Shard]:
    """Make shards of a task until they hold enough successes; later ones only make up for failures in earlier ones."""
    shards: list[Shard] = []
    successes, next_seed = 0, settings.first_seed
    while successes < settings.episodes:
        ranges = split_seeds(SeedRange(next_seed, next_seed + settings.episodes - successes), _SEEDS_PER_SHARD)
        batch = [Shard(task, seeds) for seeds in ranges]
        calls = ((folder, shard) for shard in batch)
        for seeds in results_in_order(pool, make_states, calls, ahead=2 * settings.workers):
            successes += len(seeds)
            count(len(seeds))
        shards += batch
        next_seed = ranges[-1].stop
        if not successes and next_seed - settings.first_seed >= _HOPELESS:
            tried = next_seed - settings.first_seed
            raise UserError(f"the expert failed all of its first {tried} episodes of {task}; leave it out of --tasks")
    return shards


def _alternating(
    folder: Path, made: dict[str, list[Shard]], settings: CollectSettings, seeds: dict[str, list[int]]
) -> Iterator[MetaworldEpisode]:
    """The first episode of each task, the second of each, ...; their seeds are appended to `seeds`."""
    of_tasks = [load_episodes(folder, shards, settings.pictures) for shards in made.values()]
    for episodes in islice(zip(*of_tasks, strict=False), settings.episodes):
        for episode in episodes:
            seeds[episode.task].append(episode.seed)
            yield episode
