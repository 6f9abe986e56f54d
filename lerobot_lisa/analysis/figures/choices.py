"""Which codes are used, when, after which, and for which actions."""

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from numpy.typing import NDArray

from lerobot_lisa.analysis.figures.heat_map import draw_heat_map, heat_map, height, long_table
from lerobot_lisa.analysis.figures.plot import Plot
from lerobot_lisa.analysis.figures.style import GREY, INK, PAGE_WIDTH, headline, new_figure
from lerobot_lisa.analysis.statistics.choices import Choices, over_time, transitions


def usage_plot(made: Choices, sample: str) -> Plot:
    """How often each code was chosen, and in how many episodes."""
    counts = made.counts
    shares, episodes = counts.sum(0) / counts.sum(), (counts > 0).sum(0) / made.episodes
    codes = np.arange(made.size)
    figure = new_figure(PAGE_WIDTH, 3.0)
    axes = figure.add_subplot()
    axes.bar(codes, 100 * shares, color="0.45", edgecolor=INK, linewidth=0.4)
    axes.axhline(100 / made.size, color=INK, linestyle="--", linewidth=1, label=f"all alike: 1/{made.size}")
    if made.dead:
        axes.plot(made.dead, np.zeros(len(made.dead)), "x", color=INK, label=f"never chosen: {len(made.dead)}")
    axes.set(
        xlabel="skill code",
        ylabel="share of choices (%)",
        xlim=(-0.6, made.size - 0.4),
    )
    headline(axes, f"Codes in use: perplexity {made.perplexity:.1f} of {made.size}", sample)
    axes.set_xticks(codes[:: -(-made.size // 40)])
    axes.legend(fontsize="small")
    table = pd.DataFrame(
        {"skill_code": codes, "choices": counts.sum(0), "share_of_choices": shares, "share_of_episodes": episodes}
    )
    reading = (
        "How often each code was chosen. Perplexity is how many codes are in effective use; good is well above 1 and "
        "few codes never chosen. Near 1 the codebook has collapsed, at the number of codes all are used alike."
    )
    return Plot("code_usage", "Codes in use", figure, table, reading)


def over_time_plot(made: Choices, sample: str) -> Plot:
    """Share of each code in each stretch of an episode, above it how many choices that is."""
    counts, width = over_time(made)
    shares = counts / np.maximum(counts.sum(0), 1)
    stretches = [str(number * width * made.horizon) for number in range(counts.shape[1])]
    figure = new_figure(PAGE_WIDTH, 2.1 + height(made.size))
    above, below = figure.subplots(2, 1, height_ratios=[1, max(2.0, height(made.size))])
    above.bar(range(counts.shape[1]), counts.sum(0), color=GREY, width=0.9)
    above.set(xlim=(-0.5, counts.shape[1] - 0.5), ylabel="choices")
    headline(above, "Code usage over time", sample)
    above.set_xticks([])
    draw_heat_map(below, shares, [str(code) for code in range(made.size)], stretches, "share of choices")
    below.set(xlabel=f"step of the episode (stretches of {width * made.horizon} steps)", ylabel="skill code")
    table = long_table(
        {"choices": counts, "share": shares}, list(map(str, range(made.size))), stretches, ("skill_code", "from_step")
    )
    reading = (
        "Columns are stretches of an episode and sum to 1. A code that is dark only at the left starts episodes; one "
        "that is dark far right, where few episodes are left, is what the policy does when it is stuck."
    )
    return Plot("code_usage_over_time", "Code usage over time", figure, table, reading)


def transition_plot(made: Choices, sample: str) -> Plot:
    """Which code follows which."""
    counts = transitions(made)
    shares = counts / np.maximum(counts.sum(1, keepdims=True), 1)
    codes = [str(code) for code in range(made.size)]
    again = np.trace(counts) / max(1, counts.sum())
    title, labels = "Next code (columns) after each code (rows)", ("skill code", "next skill code")
    figure = heat_map(shares, codes, codes, labels, "share of the row", title, sample)
    table = long_table({"times": counts, "share": shares}, codes, codes, ("skill_code", "next_skill_code"))
    reading = (
        f"Rows sum to 1. The diagonal is a code that goes on: {again:.0%} of all choices repeat the one before. Dark "
        "cells beside it are fixed sequences. One dark column is a code that everything falls back to: not good."
    )
    return Plot("code_transitions", "Transitions between codes", figure, table, reading)


def actions_plot(shares: NDArray[np.float64], names: Sequence[str], categorical: bool, sample: str) -> Plot:
    """What is done under each code.

    Args:
        shares: Shares of actions or means of the action's numbers, (K, A).
        names: Of the actions or numbers.
        categorical: Whether these are shares.
        sample: What was counted, for the title.
    """
    codes = [str(code) for code in range(len(shares))]
    unit = "share of steps" if categorical else "mean, by size"
    title = "Actions (rows) under each code (columns)"
    figure = heat_map(np.abs(shares.T), names, codes, ("action", "skill code"), unit, title, sample)
    if not categorical:
        _write_numbers(figure.axes[0], shares.T)
    reading = (
        "Columns sum to 1. Good is columns that differ: then codes are behaviours, not only labels of instructions."
        if categorical
        else "Mean of each action dimension, sign written in the cell, darkness its size. Good is columns that differ."
    )
    table = long_table({"value": shares}, codes, names, ("skill_code", "action"))
    return Plot("actions_by_code", "Actions under each code", figure, table, reading)


def _write_numbers(axes: Axes, values: NDArray[np.float64]) -> None:
    middle = np.nanmax(np.abs(values)) / 2 if np.isfinite(values).any() else 0
    for (row, column), value in np.ndenumerate(values):
        if np.isfinite(value):
            colour = "white" if abs(value) > middle else INK
            axes.text(column, row, f"{value:+.2f}", ha="center", va="center", fontsize=5, color=colour)
