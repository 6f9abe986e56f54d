"""An evaluation taken apart: task by task, by instruction length, of seen and unseen instructions; in numbers, as
figures, and in words."""

from collections.abc import Iterator, Mapping, Set

import numpy as np
import pandas as pd

from lerobot_lisa.analysis.drawing import GREY, INK, PAGE_WIDTH, Plot, clip, headline, new_figure
from lerobot_lisa.analysis.material import Answer, Material
from lerobot_lisa.analysis.recording.traces import Trace
from lerobot_lisa.analysis.success.rates import known_tasks, rates

MOST_LENGTHS = 6
READINGS = {
    "overall": "The whole evaluation.",
    "task group": "Groups of tasks, as LeRobot names them. A policy that has learned the whole suite has no outlier.",
    "task": "Each task by itself. Good is a column of points far right; one far left is a task it cannot do.",
    "kind of instruction": "LOReL's rephrasals of the same six tasks. Good: the other kinds reach the seen one.",
    "instruction length": "Longer instructions ask for more. Good is no fall from short to long.",
    "seen and unseen instructions": "Whether exactly this instruction is in the training data. Good: intervals that "
    "overlap, since language should generalise.",
}
"""How to read the success rates of each way of taking an evaluation apart."""


def answer(material: Material) -> Answer:
    """Does it succeed?"""
    parts = breakdowns(material.trace, material.data.instructions)
    plots = (success_plot(name, table, material.sample) for name, table in parts.items())
    return Answer(
        "success", "Success", material.data.note, plots, as_text=_as_text, numbers=_key_numbers(parts["overall"])
    )


def _as_text(table: pd.DataFrame) -> pd.DataFrame:
    rows = [
        (
            row.part,
            f"{row.percent:.1f} %",
            f"{row.low:.1f} to {row.high:.1f}",
            f"{row.successes}/{row.episodes}",
            "not known" if np.isnan(row.random_actions) else f"{row.random_actions:.1f} %",
        )
        for row in table.itertuples()
    ]
    return pd.DataFrame(rows, columns=["part", "success", "95 % interval", "episodes", "random actions"])


def _key_numbers(overall: pd.DataFrame) -> list[tuple[str, str, str]]:
    rate = overall.iloc[0]
    meaning = f"95 % interval {rate['low']:.1f} to {rate['high']:.1f}; n = {rate['episodes']:,}"
    numbers = [("Success", f"{rate['percent']:.1f} %", meaning)]
    if not np.isnan(rate["random_actions"]):
        numbers.append(("Random actions", f"{rate['random_actions']:.1f} %", "in the same tasks"))
    return numbers


def breakdowns(trace: Trace, known: Set[str] | None) -> Mapping[str, pd.DataFrame]:
    """Every way of taking the evaluation apart that makes sense for it, by name.

    Args:
        trace: The evaluation.
        known: Instructions of the training data; None: not known.
    """
    parts = {
        "overall": rates(trace.episodes, ["all episodes"] * len(trace.episodes), trace.world),
        "task group": rates(trace.episodes, trace.episodes["group"], trace.world),
        "task": by_task(trace),
        "kind of instruction": _by_kind(trace),
        "instruction length": _by_length(trace),
        "seen and unseen instructions": None if known is None else _by_acquaintance(trace, known),
    }
    kept = {name: table for name, table in parts.items() if table is not None}
    return {name: table for name, table in kept.items() if name == "overall" or len(table) > 1 or "unseen" in name}


def by_task(trace: Trace) -> pd.DataFrame:
    """One row for each task, named by what tells it apart."""
    names = task_names(trace)
    keys = zip(trace.episodes["group"], trace.episodes["task_id"], strict=True)
    return rates(trace.episodes, [names[key] for key in keys], trace.world)


def task_names(trace: Trace) -> dict[tuple[str, int], str]:
    """Name of each task: its instruction if it has only one, else its entry in `--env.task`, else group and number."""
    listed = [name.strip() for name in str(trace.origin["env"].get("task", "")).split(",")]
    tasks = trace.episodes.groupby(["group", "task_id"], sort=False, observed=True)["instruction"]
    names = {}
    for number, ((group, task_id), instructions) in enumerate(tasks):
        name = listed[number] if len(listed) == tasks.ngroups else f"{group}/{task_id}"
        always_the_same = len(instructions) > 1 and instructions.nunique() == 1
        names[group, task_id] = instructions.iloc[0] if always_the_same else name
    twice = {name for name in names.values() if list(names.values()).count(name) > 1}
    return {key: f"{name} ({key[0]}/{key[1]})" if name in twice else name for key, name in names.items()}


def _by_kind(trace: Trace) -> pd.DataFrame | None:
    """One row for each kind of instruction that the world knows (seen, unseen verb, ...); None: it knows none."""
    kinds = [task.kind for task in known_tasks(trace.episodes, trace.world) if task]
    return rates(trace.episodes, kinds, trace.world) if len(kinds) == len(trace.episodes) else None


def _by_length(trace: Trace) -> pd.DataFrame:
    """One row for each range of instruction lengths, about equally many episodes in each."""
    words = trace.episodes["instruction"].astype(str).str.split().str.len().to_numpy()
    lows = np.unique(words)
    if len(lows) > MOST_LENGTHS:
        lows = np.unique(np.quantile(words, np.arange(MOST_LENGTHS) / MOST_LENGTHS, method="higher"))
    ranges = np.searchsorted(lows, words, side="right") - 1
    names = [_range(words[ranges == number]) for number in range(len(lows))]
    return rates(trace.episodes, [names[number] for number in ranges], trace.world, names)


def _range(words: np.ndarray) -> str:
    low, high = words.min(), words.max()
    return f"{low} words" if low == high else f"{low} to {high} words"


def _by_acquaintance(trace: Trace, known: Set[str]) -> pd.DataFrame:
    """One row for instructions that occur in the training data, one for those that do not, as far as there are any."""
    names = ["seen in training", "not seen in training"]
    parts = [names[instruction not in known] for instruction in trace.episodes["instruction"]]
    return rates(trace.episodes, parts, trace.world, names)


def success_plot(name: str, table: pd.DataFrame, sample: str) -> Plot:
    """Points and 95 % intervals, one line for each part, in the given order from above.

    Args:
        name: Of the breakdown, a key of `READINGS`.
        table: As `rates` returns it.
        sample: What was counted, for the title.
    """
    figure = new_figure(min(PAGE_WIDTH, 7.5), 0.95 + 0.26 * len(table))
    axes = figure.add_subplot()
    lines, percent = np.arange(len(table)), table["percent"].to_numpy()
    reach = np.stack([percent - table["low"].to_numpy(), table["high"].to_numpy() - percent])
    axes.errorbar(percent, lines, xerr=reach, fmt="o", color=INK, capsize=3, markersize=5, linewidth=1.2)
    if table["random_actions"].notna().any():
        axes.plot(table["random_actions"], lines, "|", color=GREY, markersize=10, label="random actions")
        axes.legend(loc="best", fontsize="small")
    axes.set_yticks(lines, [f"{clip(row.part, 60)}  (n = {row.episodes})" for row in table.itertuples()])
    axes.set(xlim=(-2, 102), ylim=(len(table) - 0.5, -0.5), xlabel="success (%)")
    title = "Success" if name == "overall" else f"Success by {name}"
    headline(axes, title, sample)
    axes.grid(axis="x")
    axes.set_axisbelow(True)
    reading = READINGS[name] + " Bars are Wilson 95 % intervals: parts whose bars overlap widely may well be equal."
    return Plot(f"success_{name.replace(' ', '_')}", title, figure, table, reading)


def said(table: pd.DataFrame) -> Iterator[str]:
    """A line for each row of `rates`: counts, interval, random actions where known, and the part's name."""
    for row in table.itertuples():
        beside = "" if np.isnan(row.random_actions) else f"; random actions {row.random_actions:.1f} %"
        interval = f"95 % interval {row.low:.1f} to {row.high:.1f}{beside}"
        yield f"{clip(row.part, 100)}: {row.percent:.1f} % success ({row.successes}/{row.episodes}; {interval})"
