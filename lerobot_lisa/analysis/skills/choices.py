"""Which skill codes are chosen: how often, when in an episode, after which other, and for which actions."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from numpy.typing import NDArray

from lerobot_lisa.analysis.drawing import (
    GREY,
    INK,
    PAGE_WIDTH,
    Grid,
    Plot,
    clip,
    draw_heat_map,
    headline,
    heat_map,
    height,
    new_figure,
)  # fmt: skip
from lerobot_lisa.analysis.recording.traces import KEY, Trace
from lerobot_lisa.analysis.skills.information import entropy

Counts = NDArray[np.int64]
Numbers = NDArray[np.float64]


@dataclass(frozen=True)
class Choices:
    """Every choice that the skill predictor made in a trace: one at steps 0, H, 2H, ... of each episode.

    Attributes:
        table: One row for each choice, in order: `episode` (its row in the trace's episodes), `chunk` and `code`.
        episodes: E.
        labels: Of the K codes.
        horizon: H, steps that a code holds.
    """

    table: pd.DataFrame
    episodes: int
    labels: Sequence[str]
    horizon: int

    @property
    def size(self) -> int:
        """K, codes in the codebook."""
        return len(self.labels)

    @property
    def counts(self) -> Counts:
        """How often each episode chose each code, (E, K)."""
        counts = np.zeros((self.episodes, self.size), np.int64)
        np.add.at(counts, (self.table["episode"].to_numpy(), self.table["code"].to_numpy()), 1)
        return counts

    @property
    def used(self) -> Counts:
        """Whether each episode chose each code, (E, K)."""
        return (self.counts > 0).astype(np.int64)

    @property
    def first(self) -> Counts:
        """Whether each code was the first of each episode, (E, K)."""
        return np.eye(self.size, dtype=np.int64)[self.table["code"].to_numpy()[self.table["chunk"].to_numpy() == 0]]

    @property
    def perplexity(self) -> float:
        """How many codes are in effective use, over all choices."""
        return float(2 ** entropy(self.counts.sum(0).astype(np.float64)))

    @property
    def dead(self) -> list[int]:
        """Codes that were never chosen."""
        return np.flatnonzero(self.counts.sum(0) == 0).tolist()


def choices(trace: Trace) -> Choices:
    """The choices in a trace of a policy with skill codes."""
    horizon = trace.origin["policy"]["horizon"]
    chosen = trace.steps[trace.steps["step"] % horizon == 0]
    place = pd.MultiIndex.from_frame(trace.episodes[KEY]).get_indexer(pd.MultiIndex.from_frame(chosen[KEY]))
    numbers = {"chunk": (chosen["step"] // horizon).to_numpy(), "code": chosen["code"].to_numpy(np.int64)}
    return Choices(pd.DataFrame({"episode": place, **numbers}), len(trace.episodes), trace.code_labels, horizon)


def over_time(made: Choices, most: int = 50) -> tuple[Counts, int]:
    """How often each code was chosen in each stretch of an episode.

    Args:
        made: The choices.
        most: Stretches at most; longer episodes get longer ones.

    Returns:
        Counts (K, T) and how many chunks a stretch has.
    """
    width = -(-(int(made.table["chunk"].max()) + 1) // most)
    stretch = made.table["chunk"].to_numpy() // width
    counts = np.zeros((made.size, int(stretch.max()) + 1), np.int64)
    np.add.at(counts, (made.table["code"].to_numpy(), stretch), 1)
    return counts, width


def transitions(made: Choices) -> Counts:
    """How often each code (row) was followed by each code (column) in the same episode, (K, K)."""
    counts = np.zeros((made.size, made.size), np.int64)
    for _, codes in made.table.groupby("episode")["code"]:
        np.add.at(counts, (codes.to_numpy()[:-1], codes.to_numpy()[1:]), 1)
    return counts


def actions_by_code(trace: Trace, size: int, classes: int) -> Numbers:
    """What is done under each code.

    Args:
        trace: Of a policy with skill codes.
        size: K.
        classes: Number of different actions; 0 for real numbers.

    Returns:
        Shares of the actions (K, classes), or means of the action's numbers (K, A); nan for codes never followed.
    """
    codes, actions = trace.steps["code"].to_numpy(np.int64), np.stack(trace.steps["action"].to_list())
    values = np.eye(classes)[actions[:, 0].round().astype(np.int64)] if classes else actions.astype(np.float64)
    sums, steps = np.zeros((size, values.shape[1])), np.bincount(codes, minlength=size)[:, None]
    np.add.at(sums, codes, values)
    return np.divide(sums, steps, out=np.full_like(sums, np.nan), where=steps > 0)


def plots(trace: Trace, made: Choices, action_names: Sequence[str] | None, sample: str) -> Iterator[Plot]:
    """Usage, usage over time, transitions, actions.

    Args:
        trace: Of the evaluation.
        made: Its choices.
        action_names: Of classes or dimensions; None or not as many as there are: they are numbered.
        sample: What was counted, for headlines.
    """
    yield _usage_plot(made, sample)
    yield _over_time_plot(made, sample)
    yield _transition_plot(made, sample)
    classes = trace.origin["policy"]["action_classes"]
    done = actions_by_code(trace, made.size, classes)
    fits = action_names is not None and len(action_names) == done.shape[1]
    names = list(action_names or ()) if fits else [f"action {number}" for number in range(done.shape[1])]
    yield _actions_plot(Grid(done.T, names, made.labels, ("action", "skill code"), ""), classes > 0, sample)


def _usage_plot(made: Choices, sample: str) -> Plot:
    """How often each code was chosen, and in how many episodes."""
    counts, codes = made.counts, np.arange(made.size)
    shares = counts.sum(0) / counts.sum()
    figure = new_figure(PAGE_WIDTH, 3.0)
    axes = figure.add_subplot()
    axes.bar(codes, 100 * shares, color="0.45", edgecolor=INK, linewidth=0.4)
    axes.axhline(100 / made.size, color=INK, linestyle="--", linewidth=1, label=f"all alike: 1/{made.size}")
    if made.dead:
        axes.plot(made.dead, np.zeros(len(made.dead)), "x", color=INK, label=f"never chosen: {len(made.dead)}")
    axes.set(xlabel="skill code", ylabel="share of choices (%)", xlim=(-0.6, made.size - 0.4))
    headline(axes, f"Codes in use: perplexity {made.perplexity:.1f} of {made.size}", sample)
    every = -(-made.size // 40)
    shown = [clip(label, 16) for label in made.labels]
    axes.set_xticks(codes[::every], shown[::every], rotation=90 if max(map(len, shown)) > 4 else 0)
    axes.legend(fontsize="small")
    numbers = {"choices": counts.sum(0), "share_of_choices": shares, "share_of_episodes": made.used.mean(0)}
    reading = (
        "How often each code was chosen. Perplexity is how many codes are in effective use; good is well above 1 and "
        "few codes never chosen. Near 1 the codebook has collapsed, at the number of codes all are used alike."
    )
    return Plot("code_usage", "Codes in use", figure, pd.DataFrame({"skill_code": made.labels, **numbers}), reading)


def _over_time_plot(made: Choices, sample: str) -> Plot:
    """Share of each code in each stretch of an episode, above it how many choices that is."""
    counts, width = over_time(made)
    shares = counts / np.maximum(counts.sum(0), 1)
    stretches = [str(number * width * made.horizon) for number in range(counts.shape[1])]
    grid = Grid(shares, made.labels, stretches, ("skill code", "from step"), "share of choices")
    figure = new_figure(PAGE_WIDTH, 2.1 + height(made.size))
    above, below = figure.subplots(2, 1, height_ratios=[1, max(2.0, height(made.size))])
    above.bar(range(counts.shape[1]), counts.sum(0), color=GREY, width=0.9)
    above.set(xlim=(-0.5, counts.shape[1] - 0.5), ylabel="choices")
    headline(above, "Code usage over time", sample)
    above.set_xticks([])
    draw_heat_map(below, grid)
    below.set(xlabel=f"step of the episode (stretches of {width * made.horizon} steps)")
    reading = (
        "Columns are stretches of an episode and sum to 1. A code that is dark only at the left starts episodes; one "
        "that is dark far right, where few episodes are left, is what the policy does when it is stuck."
    )
    table = grid.table(choices=counts, share=shares)
    return Plot("code_usage_over_time", "Code usage over time", figure, table, reading)


def _transition_plot(made: Choices, sample: str) -> Plot:
    """Which code follows which."""
    counts = transitions(made)
    shares = counts / np.maximum(counts.sum(1, keepdims=True), 1)
    grid = Grid(shares, made.labels, made.labels, ("skill code", "next skill code"), "share of the row")
    again = np.trace(counts) / max(1, counts.sum())
    reading = (
        f"Rows sum to 1. The diagonal is a code that goes on: {again:.0%} of all choices repeat the one before. Dark "
        "cells beside it are fixed sequences. One dark column is a code that everything falls back to: not good."
    )
    figure = heat_map(grid, "Next code (columns) after each code (rows)", sample)
    table = grid.table(times=counts, share=shares)
    return Plot("code_transitions", "Transitions between codes", figure, table, reading)


def _actions_plot(done: Grid, categorical: bool, sample: str) -> Plot:
    """What is done under each code: `actions_by_code`, turned, (A, K)."""
    unit = "share of steps" if categorical else "mean, by size"
    sizes = Grid(np.abs(done.values), done.rows, done.columns, done.axes, unit)
    figure = heat_map(sizes, "Actions (rows) under each code (columns)", sample)
    if not categorical:
        _write_numbers(figure.axes[0], done.values)
    reading = (
        "Columns sum to 1. Good is columns that differ: then codes are behaviours, not only labels of instructions."
        if categorical
        else "Mean of each action dimension, sign written in the cell, darkness its size. Good is columns that differ."
    )
    return Plot("actions_by_code", "Actions under each code", figure, done.table(value=done.values), reading)


def _write_numbers(axes: Axes, values: Numbers) -> None:
    middle = np.nanmax(np.abs(values)) / 2 if np.isfinite(values).any() else 0
    for (row, column), value in np.ndenumerate(values):
        if np.isfinite(value):
            colour = "white" if abs(value) > middle else INK
            axes.text(column, row, f"{value:+.2f}", ha="center", va="center", fontsize=5, color=colour)
