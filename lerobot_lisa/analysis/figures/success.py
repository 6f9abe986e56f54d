"""Success rates as points with their Wilson intervals."""

import numpy as np
import pandas as pd

from lerobot_lisa.analysis.figures.plot import Plot
from lerobot_lisa.analysis.figures.style import GREY, INK, PAGE_WIDTH, headline, new_figure

READINGS = {
    "overall": "The whole evaluation.",
    "task group": "Groups of tasks, as LeRobot names them. A policy that has learned the whole suite has no outlier.",
    "task": "Each task by itself. Good is a column of points far right; one far left is a task it cannot do.",
    "kind of instruction": "LOReL's rephrasals of the same six tasks. Good: the other kinds reach the seen one.",
    "instruction length": "Longer instructions ask for more. Good is no fall from short to long.",
    "seen and unseen instructions": "Whether exactly this instruction is in the training data. Good: intervals that "
    "overlap, since language should generalise.",
}


def success_plot(name: str, rates: pd.DataFrame, sample: str) -> Plot:
    """Points and 95 % intervals, one line for each part, in the given order from above.

    Args:
        name: Of the breakdown, a key of `READINGS`.
        rates: As `breakdown.rates` returns them.
        sample: What was counted, for the title.
    """
    figure = new_figure(min(PAGE_WIDTH, 7.5), 0.95 + 0.26 * len(rates))
    axes = figure.add_subplot()
    lines = np.arange(len(rates))
    percent = rates["percent"].to_numpy()
    reach = np.stack([percent - rates["low"].to_numpy(), rates["high"].to_numpy() - percent])
    axes.errorbar(percent, lines, xerr=reach, fmt="o", color=INK, capsize=3, markersize=5, linewidth=1.2)
    if rates["random_actions"].notna().any():
        axes.plot(rates["random_actions"], lines, "|", color=GREY, markersize=10, label="random actions")
        axes.legend(loc="best", fontsize="small")
    axes.set_yticks(lines, [_label(row) for row in rates.itertuples()])
    axes.set(xlim=(-2, 102), ylim=(len(rates) - 0.5, -0.5), xlabel="success (%)")
    title = "Success" if name == "overall" else f"Success by {name}"
    headline(axes, title, sample)
    axes.grid(axis="x")
    axes.set_axisbelow(True)
    reading = READINGS[name] + " Bars are Wilson 95 % intervals: parts whose bars overlap widely may well be equal."
    return Plot(f"success_{name.replace(' ', '_')}", title, figure, rates, reading)


def _label(row: object) -> str:
    part = str(row.part)  # type: ignore[attr-defined]
    shown = part if len(part) <= 60 else part[:59] + "…"
    return f"{shown}  (n = {row.episodes})"  # type: ignore[attr-defined]
