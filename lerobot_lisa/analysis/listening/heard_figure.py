"""Success by the steps allowed, told the truth and told otherwise, as a figure, and a report's section on listening."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from lerobot_lisa.analysis.drawing import GREY, INK, Plot, headline, new_figure
from lerobot_lisa.analysis.listening.heard import NO_DEMONSTRATOR, READING, Runs, key_numbers, table
from lerobot_lisa.analysis.listening.other_words import NOTHING, OTHER
from lerobot_lisa.analysis.material import Answer

_TITLE = "Does it listen?"
_TOLD = {OTHER: "told another one", NOTHING: "told nothing"}
_INTRODUCTION = (
    "Every episode was run a second time from the same start with the same random numbers, told another instruction; "
    "success is reaching the episode's own goal both times, so that what is reached by wandering about cancels."
)
_NOTHING_ELSE = "Every episode of this evaluation is told the same: whether the policy listens cannot be measured."
_UNITS = {True: "steps allowed, in units of the demonstrator's", False: "steps allowed"}


def answer(runs: Runs, sample: str) -> Answer:
    """Does it listen? `sample` says what was counted."""
    said = _INTRODUCTION if runs.otherwise is not None else _NOTHING_ELSE
    if runs.pairs["demonstrator"].isna().all():
        said += f" There is {NO_DEMONSTRATOR}."
    plots = (heard_plot(runs, sample) for _ in range(1))  # drawn when it is asked for, in the page's style
    return Answer("listening", "Listening", said, plots, as_text=_as_text, numbers=key_numbers(runs))


def _as_text(numbers: pd.DataFrame) -> pd.DataFrame:
    rows = [(row.part, row.number, *_value(row), f"{row.episodes}") for row in numbers.itertuples()]
    return pd.DataFrame(rows, columns=["part", "number", "value", "95 % interval", "episodes"])


def _value(row: Any) -> tuple[str, str]:
    digits = 1 if row.unit else 2
    return f"{row.value:.{digits}f} {row.unit}".rstrip(), f"{row.low:.{digits}f} to {row.high:.{digits}f}"


def heard_plot(runs: Runs, sample: str) -> Plot:
    """Success by steps, as two curves; `sample` says what was counted, for the title."""
    has_unit = bool(runs.pairs["demonstrator"].notna().any())
    pairs = runs.pairs.dropna(subset="demonstrator") if has_unit else runs.pairs
    unit = pairs["demonstrator"] if has_unit else 1.0
    told = pairs["told_otherwise"].notna()
    curves = {"told its own instruction": pairs["steps"] / unit}
    if told.any():
        curves[_TOLD[runs.told]] = (pairs["steps_otherwise"] / unit)[told]
    figure = new_figure(6.5, 3.4)
    axes = figure.add_subplot()
    _draw(axes, curves)
    if has_unit:
        axes.set_xscale("log", base=2)
        axes.xaxis.set_major_formatter("{x:g}")
    axes.set(ylim=(-2, 102), ylabel="success (%)", xlabel=_UNITS[has_unit])
    axes.legend(loc="best", fontsize="small")
    axes.grid()
    headline(axes, _TITLE, sample)
    reading = f"{READING} Heard is the distance of the curves at their right end."
    return Plot("heard", _TITLE, figure, table(runs), reading)


def _draw(axes: Axes, curves: Mapping[str, pd.Series]) -> None:
    """Curves up to the share of episodes that succeeded at all; steps of others are inf."""
    finite = [ratio for ratios in curves.values() for ratio in ratios if np.isfinite(ratio)]
    last = max(finite, default=1.0)
    for (label, ratios), colour in zip(curves.items(), (INK, GREY), strict=False):
        reached = np.sort(ratios[np.isfinite(ratios)])
        percent = 100 * np.arange(1, len(reached) + 1) / len(ratios)
        end = percent[-1] if len(percent) else 0.0
        axes.step([*reached, last], [*percent, end], where="post", color=colour, label=label, linewidth=1.4)
