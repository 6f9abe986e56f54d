"""Ranges of seeds: which seeds may make training data, and how a run is cut into shards."""

from collections.abc import Sequence
from typing import NamedTuple

from lerobot_lisa.errors import UserError

FIRST_TRAINING_SEED = 1_000_000
"""Seeds below are reserved for evaluation, so that no evaluated episode can be in the training data."""

_LAST_SEED = 2**62  # datasets keep seeds as int64
_MOST_EPISODES = 10**8
_MOST_SEEDS = 20  # named in a card; the others are those that meta/episodes lacks


class SeedRange(NamedTuple):
    """The seeds from `first` up to but not including `stop`."""

    first: int
    stop: int


def split_seeds(seeds: SeedRange, size: int) -> list[SeedRange]:
    """Cut a range into ranges of `size` seeds; the last one may be shorter."""
    return [SeedRange(start, min(start + size, seeds.stop)) for start in range(seeds.first, seeds.stop, size)]


def check_run(episodes: int, workers: int, first_seed: int) -> None:
    """Raise `UserError` for a number of episodes, of workers or a first seed that no run can have."""
    if not 1 <= episodes <= _MOST_EPISODES or workers < 1:
        raise UserError(f"--episodes must be 1 to {_MOST_EPISODES:,}, and --workers at least 1")
    if first_seed > _LAST_SEED:
        raise UserError(f"--first-seed {first_seed} is too large: use {_LAST_SEED} or less")
    if first_seed < FIRST_TRAINING_SEED:
        raise UserError(
            f"--first-seed {first_seed} is reserved: seeds below {FIRST_TRAINING_SEED} are for evaluation, "
            f"so that no policy is trained on them; use {FIRST_TRAINING_SEED} or more"
        )


def describe_seeds(first_seed: int, seeds: Sequence[int]) -> str:
    """The range of seeds that a dataset was made from, and those whose episode failed, of which the first are named.

    Args:
        first_seed: of the range.
        seeds: of the episodes in the dataset, in order.
    """
    failed = sorted(set(range(first_seed, seeds[-1] + 1)) - set(seeds))
    more = f" and {len(failed) - _MOST_SEEDS:,} more" if len(failed) > _MOST_SEEDS else ""
    named = f" ({', '.join(map(str, failed[:_MOST_SEEDS]))}{more})" if failed else ""
    return f"{first_seed} to {seeds[-1]}, {len(failed):,} failures left out{named}"
