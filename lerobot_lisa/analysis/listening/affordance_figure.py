"""The affordance test as a figure: how often each instruction chooses the task's code, from the same starts."""

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from lerobot_lisa.analysis.drawing import GREY, INK, LIGHT, PAGE_WIDTH, Plot, clip, headline, new_figure
from lerobot_lisa.analysis.success.rates import success_rate

_TITLE = "Is the task's skill code chosen because it is asked for?"


def affordance_plot(rows: pd.DataFrame, code: str, reading: str, sample: str) -> Plot:
    """A line for each instruction, those that mean the task first.

    Args:
        rows: From `affordance.table`.
        code: What the task's own code is called.
        reading: How to read it.
        sample: What was counted, for the headline.
    """
    figure = new_figure(PAGE_WIDTH, 1.4 + 0.22 * len(rows))
    axes = figure.add_subplot()
    for line, row in enumerate(rows.itertuples()):
        _draw_row(axes, line, row)
    for line in np.flatnonzero(rows["shares"].to_numpy()[1:] != rows["shares"].to_numpy()[:-1]):
        axes.axhline(line + 0.5, color=LIGHT, linewidth=0.8)
    axes.set_yticks(
        range(len(rows)), [f"{clip(row.instruction)}  ({row.shares})" for row in rows.itertuples()], fontsize=8
    )
    axes.set(ylim=(len(rows) - 0.5, -0.5), xlim=(-2, 102), xlabel="episodes (%)")
    axes.grid(axis="x")
    axes.set_axisbelow(True)
    handles, labels = axes.get_legend_handles_labels()
    named = dict(zip(labels, handles, strict=True))
    axes.legend(named.values(), named.keys(), fontsize="small", loc="upper left", bbox_to_anchor=(1, 1))
    headline(axes, f"{_TITLE} (code {clip(code)})", sample)
    return Plot("affordance", _TITLE, figure, rows, reading)


def _draw_row(axes: Axes, line: int, row: Any) -> None:
    first = success_rate([True] * row.first + [False] * (row.episodes - row.first))
    axes.plot([first.low, first.high], [line, line], color=GREY, linewidth=1)
    axes.plot(100 * row.success / row.episodes, line, "x", color=GREY, label="task done")
    axes.plot(100 * row.ever / row.episodes, line, "o", color=INK, markerfacecolor="white", label="chosen at all")
    axes.plot(first.percent, line, "o", color=INK, markersize=4, label="chosen first, and 95 % interval")
