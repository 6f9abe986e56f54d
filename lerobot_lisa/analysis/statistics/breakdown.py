"""Success rates of parts of an evaluation: task by task, by instruction length, of seen and unseen instructions."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from lerobot_lisa.analysis import lorel_tasks
from lerobot_lisa.analysis.recording.traces import Trace
from lerobot_lisa.analysis.success import success_rate

MOST_LENGTHS = 6


def rates(episodes: pd.DataFrame, parts: Sequence[Any]) -> pd.DataFrame:
    """Success rate of each part, in order of first occurrence.

    Args:
        episodes: Columns of `traces.EPISODES`.
        parts: Name of the part that each episode belongs to.

    Returns:
        Columns `part`, `successes`, `episodes`, `percent`, `low`, `high` (Wilson 95 % interval, in percent) and
        `random_actions`, in percent, nan where it is not known.
    """
    rows = []
    for part, of_part in episodes.groupby(np.asarray(parts, object), sort=False):
        rate = success_rate(of_part["success"])
        numbers = (rate.successes, rate.episodes, rate.percent, rate.low, rate.high)
        rows.append((str(part), *numbers, _random_actions(of_part)))
    names = ["part", "successes", "episodes", "percent", "low", "high", "random_actions"]
    return pd.DataFrame(rows, columns=names)


def _random_actions(episodes: pd.DataFrame) -> float:
    tasks = episodes.groupby(["group", "task_id"], observed=True)["success"]
    floor = lorel_tasks.floor({name: list(outcomes) for name, outcomes in tasks})
    return np.nan if floor is None else floor


def overall(trace: Trace) -> pd.DataFrame:
    """One row for everything."""
    return rates(trace.episodes, ["all episodes"] * len(trace.episodes))


def by_group(trace: Trace) -> pd.DataFrame:
    """One row for each task group."""
    return rates(trace.episodes, trace.episodes["group"])


def by_task(trace: Trace) -> pd.DataFrame:
    """One row for each task, named by what tells it apart."""
    names = task_names(trace)
    keys = zip(trace.episodes["group"], trace.episodes["task_id"], strict=True)
    return rates(trace.episodes, [names[key] for key in keys])


def task_names(trace: Trace) -> dict[tuple[str, int], str]:
    """Name of each task: its instruction if it has only one, else its entry in `--env.task`, else group and number."""
    listed = [name.strip() for name in str(trace.facts["env"].get("task", "")).split(",")]
    tasks = trace.episodes.groupby(["group", "task_id"], sort=False, observed=True)["instruction"]
    names = {}
    for number, ((group, task_id), instructions) in enumerate(tasks):
        name = listed[number] if len(listed) == tasks.ngroups else f"{group}/{task_id}"
        always_the_same = len(instructions) > 1 and instructions.nunique() == 1
        names[group, task_id] = instructions.iloc[0] if always_the_same else name
    twice = {name for name in names.values() if list(names.values()).count(name) > 1}
    return {key: f"{name} ({key[0]}/{key[1]})" if name in twice else name for key, name in names.items()}


def by_length(trace: Trace) -> pd.DataFrame:
    """One row for each range of instruction lengths, about equally many episodes in each."""
    words = trace.episodes["instruction"].astype(str).str.split().str.len().to_numpy()
    lows = np.unique(words)
    if len(lows) > MOST_LENGTHS:
        lows = np.unique(np.quantile(words, np.arange(MOST_LENGTHS) / MOST_LENGTHS, method="higher"))
    ranges = np.searchsorted(lows, words, side="right") - 1
    order = np.argsort(ranges, kind="stable")
    names = [_range(words[ranges == number]) for number in range(len(lows))]
    return rates(trace.episodes.iloc[order], [names[ranges[place]] for place in order])


def _range(words: np.ndarray) -> str:
    low, high = words.min(), words.max()
    return f"{low} words" if low == high else f"{low} to {high} words"


def by_kind(trace: Trace) -> pd.DataFrame | None:
    """One row for each of LOReL's kinds of instructions (seen, unseen verb, ...); None for other environments."""
    tasks = [lorel_tasks.find_task(key) for key in zip(trace.episodes["group"], trace.episodes["task_id"], strict=True)]
    kinds = [task.kind for task in tasks if task]
    return rates(trace.episodes, kinds) if len(kinds) == len(tasks) else None


def by_acquaintance(trace: Trace, known: set[str]) -> pd.DataFrame:
    """One row for instructions that occur in the training data, one for those that do not, as far as there are any."""
    names = {True: "seen in training", False: "not seen in training"}
    seen = trace.episodes["instruction"].isin(known).to_numpy()
    order = np.argsort(~seen, kind="stable")
    return rates(trace.episodes.iloc[order], [names[bool(seen[place])] for place in order])


def breakdowns(trace: Trace, known: set[str] | None) -> Mapping[str, pd.DataFrame]:
    """Every way of taking the evaluation apart that makes sense for it, by name.

    Args:
        trace: The evaluation.
        known: Instructions of the training data; None: not known.
    """
    parts = {
        "overall": overall(trace),
        "task group": by_group(trace),
        "task": by_task(trace),
        "kind of instruction": by_kind(trace),
        "instruction length": by_length(trace),
        "seen and unseen instructions": None if known is None else by_acquaintance(trace, known),
    }
    kept = {name: table for name, table in parts.items() if table is not None}
    return {name: table for name, table in kept.items() if name == "overall" or len(table) > 1 or "unseen" in name}
