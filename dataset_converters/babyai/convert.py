"""Original BabyAI demonstration files as LeRobot datasets, in one pass and bounded memory."""

import random
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from dataset_converters.babyai.cards import converted_card
from dataset_converters.babyai.demo_files import count_demonstrations, level_from_name, read_demonstrations
from dataset_converters.babyai.demonstration import Demonstration
from dataset_converters.babyai.encodings import CellEncoding
from dataset_converters.babyai.schema import babyai_layout, to_episodes
from dataset_converters.card import write_card
from dataset_converters.staging import staged
from dataset_converters.workers import progress
from dataset_converters.writer import DatasetTotals, write_dataset
from lerobot_lisa.envs.babyai.levels import check_level
from lerobot_lisa.errors import UserError


@dataclass(frozen=True)
class ConvertSettings:
    """What to convert, and which part of it.

    Attributes:
        limit: number of demonstrations; None takes all.
        subset_seed: takes a random subset as the LISA paper does, instead of the first `limit`.
        encoding: cell encoding of the file; None detects it.
    """

    source: Path
    root: Path
    repo_id: str
    level: str | None = None
    limit: int | None = None
    subset_seed: int | None = None
    encoding: CellEncoding | None = None


def convert(settings: ConvertSettings) -> DatasetTotals:
    """Convert one original file; episodes keep the order of the file and remember their index in it.

    Raises:
        UserError: for anything wrong with the file, the selection or the output; nothing is left behind then.
    """
    level = _level(settings)
    indices = _selection(settings)
    described = {key: str(value) for key, value in vars(settings).items()}
    with staged(settings.root, described) as partial:
        chosen = _chosen(settings, level, indices)
        total = len(indices) if indices is not None else None
        with progress(chosen, total, "converting") as episodes:
            totals = write_dataset(partial / "dataset", babyai_layout(settings.repo_id), to_episodes(episodes))
        encoding = settings.encoding.value if settings.encoding else "detected, rewritten as minigrid's"
        card = converted_card(level, settings.source, _described_selection(settings), encoding)
        write_card(partial / "dataset", settings.repo_id, card)
    return totals


def subset_indices(total: int, count: int, seed: int) -> list[int]:
    """Indices of the subset that the LISA paper trains on: shuffle all with `seed`, take the first `count`.

    They are returned in increasing order: a policy never sees the order of episodes.
    """
    indices = list(range(total))
    random.Random(seed).shuffle(indices)
    return sorted(indices[:count])


def _level(settings: ConvertSettings) -> str:
    level = settings.level or level_from_name(settings.source)
    if level is None:
        raise UserError(f"{settings.source}: its name does not tell the level; say --level, such as --level GoToSeq")
    return check_level(level)


def _selection(settings: ConvertSettings) -> range | list[int] | None:
    """Increasing indices to keep; None keeps all."""
    if settings.limit is None:
        if settings.subset_seed is not None:
            raise UserError("--subset-seed needs --limit, the size of the subset")
        return None
    if settings.limit < 1:
        raise UserError("--limit must be at least 1")
    total = count_demonstrations(settings.source)
    if settings.limit > total:
        raise UserError(f"{settings.source}: --limit {settings.limit} is more than its {total} demonstrations")
    if settings.subset_seed is None:
        return range(settings.limit)
    return subset_indices(total, settings.limit, settings.subset_seed)


def _chosen(
    settings: ConvertSettings, level: str, indices: range | list[int] | None
) -> Iterator[tuple[Demonstration, int]]:
    keep = None if indices is None else set(indices)
    last = None if indices is None else indices[-1]
    for index, demo in enumerate(read_demonstrations(settings.source, level, settings.encoding)):
        if keep is None or index in keep:
            yield demo, index
        if index == last:
            return


def _described_selection(settings: ConvertSettings) -> str:
    if settings.limit is None:
        return "all demonstrations"
    if settings.subset_seed is None:
        return f"its first {settings.limit} demonstrations"
    return f"{settings.limit} demonstrations drawn with subset seed {settings.subset_seed}"
