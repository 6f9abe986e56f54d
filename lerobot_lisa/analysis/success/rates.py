"""Success rates: with Wilson intervals, of any parts of an evaluation, beside what random actions achieve."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import binomtest

from lerobot_lisa.envs.known_tasks import KnownTask, known_task


@dataclass(frozen=True)
class SuccessRate:
    """How often a policy succeeded.

    Attributes:
        successes: Successful episodes.
        episodes: All episodes, n.
        percent: Success rate in percent.
        low: Lower end of its Wilson 95 % interval, in percent.
        high: Upper end.
    """

    successes: int
    episodes: int
    percent: float
    low: float
    high: float

    def __str__(self) -> str:
        counts = f"{self.successes}/{self.episodes}"
        return f"{counts:>9}  {self.percent:5.1f} %  (95 % interval {self.low:.1f} to {self.high:.1f} %)"


def success_rate(outcomes: Iterable[bool]) -> SuccessRate:
    """Success rate of at least one episode, with the Wilson score interval.

    Wilson's interval (E. B. Wilson, 1927) also holds near 0 and 100 %, where the usual plus-minus does not.
    """
    listed = list(outcomes)
    successes, episodes = sum(listed), len(listed)
    interval = binomtest(successes, episodes).proportion_ci(confidence_level=0.95, method="wilson")
    return SuccessRate(successes, episodes, 100 * successes / episodes, 100 * interval.low, 100 * interval.high)


def rates(
    episodes: pd.DataFrame, parts: Sequence[Any], world: str | None, order: Sequence[str] | None = None
) -> pd.DataFrame:
    """Success rate of each part of an evaluation.

    Args:
        episodes: Columns `group`, `task_id` and `success`, a row for each of E episodes.
        parts: Name of the part that each episode belongs to, (E,).
        world: `--env.type`; by it random actions are looked up.
        order: Of the parts; None: that of first occurrence.

    Returns:
        Columns `part`, those of `SuccessRate`, and `random_actions`: the success rate of random actions in percent, in
        the same tasks as often as they occur; nan where it is not known.
    """
    grouped = dict(iter(episodes.groupby(np.asarray(parts, object), sort=False)))
    rows = []
    for part in grouped if order is None else order:
        if part in grouped:
            rate, floor = success_rate(grouped[part]["success"]), _floor(grouped[part], world)
            rows.append({"part": str(part), **vars(rate), "random_actions": floor})
    return pd.DataFrame(rows)


def known_tasks(episodes: pd.DataFrame, world: str | None) -> list[KnownTask | None]:
    """What the world knows of each episode's task, (E,)."""
    keys = list(zip(episodes["group"].astype(str), episodes["task_id"].astype(int), strict=True))
    found = {key: known_task(world, *key) for key in set(keys)}
    return [found[key] for key in keys]


def _floor(episodes: pd.DataFrame, world: str | None) -> float:
    return float(np.mean([task.random_actions if task else np.nan for task in known_tasks(episodes, world)]))
