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
    MOST_CODES,
    PAGE_WIDTH,
    Grid,
    Plot,
    draw_heat_map,
    headline,
    heat_map,
    height,
    new_figure,
    shorten,
)  # fmt: skip
from lerobot_lisa.analysis.recording.traces import KEY, Trace
from lerobot_lisa.analysis.skills.information import entropy

Counts = NDArray[np.int64]
Numbers = NDArray[np.float64]


@dataclass(frozen=True)
class Choices:
    """Every choice that the skill predictor made in a trace: one at steps 0, H, 2H, ... of each episode, or more often.

    Attributes:
        table: One row for each choice, in order: `episode` (its row in the trace's episodes), `chunk` and `code`, its
            place among `codes`.
        episodes: E.
        codes: The C codes that are told about: all K of a small codebook in order; of a larger one those that were
            chosen, the most frequent first.
        labels: What those are called.
        horizon: Steps from one choice to the next: H, fewer with learned termination.
        size: K, codes in the codebook.
    """

    table: pd.DataFrame
    episodes: int
    codes: Sequence[int]
    labels: Sequence[str]
    horizon: int
    size: int

    @property
    def counts(self) -> Counts:
        """How often each episode chose each code, (E, C)."""
        counts = np.zeros((self.episodes, len(self.codes)), np.int64)
        np.add.at(counts, (self.table["episode"].to_numpy(), self.table["code"].to_numpy()), 1)
        return counts

    @property
    def used(self) -> Counts:
        """Whether each episode chose each code, (E, C)."""
        return (self.counts > 0).astype(np.int64)

    @property
    def first(self) -> Counts:
        """Whether each code was the first of each episode, (E, C)."""
        return (self.table.loc[self.table["chunk"] == 0, "code"].to_numpy()[:, None] == np.arange(len(self.codes))) * 1

    @property
    def perplexity(self) -> float:
        """How many codes are in effective use, over all choices."""
        return float(2 ** entropy(self.counts.sum(0).astype(np.float64)))

    @property
    def dead(self) -> list[int]:
        """Codes that were never chosen."""
        chosen = {self.codes[place] for place in self.table["code"].unique()}
        return [code for code in range(self.size) if code not in chosen]

    def left_out(self, most: int = MOST_CODES) -> str:
        """A sentence on the codes that a figure of so many lacks; none if it shows all."""
        never, rarer = self.size - len(self.codes), max(0, len(self.codes) - most)
        parts = [f"{never:,} codes that were never chosen"] * bool(never) + [f"the {rarer:,} rarest"] * bool(rarer)
        return f" Left out: {' and '.join(parts)}." if parts else ""


def choices(trace: Trace) -> Choices:
    """The choices in a trace of a policy with skill codes."""
    every = trace.question_stride
    chosen = trace.steps[trace.steps["step"] % every == 0]
    place = pd.MultiIndex.from_frame(trace.episodes[KEY]).get_indexer(pd.MultiIndex.from_frame(chosen[KEY]))
    labels, numbers = trace.code_labels, chosen["code"].to_numpy(np.int64)
    codes = np.arange(len(labels))
    if len(labels) > MOST_CODES:
        used, times = np.unique(numbers, return_counts=True)
        codes = used[np.argsort(-times, kind="stable")]
    places = np.argsort(codes)[np.searchsorted(np.sort(codes), numbers)]
    table = pd.DataFrame({"episode": place, "chunk": (chosen["step"] // every).to_numpy(), "code": places})
    named = [labels[code] for code in codes]
    return Choices(table, len(trace.episodes), codes.tolist(), named, every, len(labels))


def begun(made: Choices, most: int) -> int:
    """How many skills were begun: one where a code was said that was not followed, or had been for `most` choices."""
    table = made.table
    other = (table["chunk"] == 0) | (table["code"] != table["code"].shift())
    place = np.arange(len(table))
    return int(((place - np.maximum.accumulate(np.where(other, place, 0))) % most == 0).sum())


def over_time(made: Choices, most: int = 50) -> tuple[Counts, int]:
    """How often each code was chosen in each stretch of an episode.

    Args:
        made: The choices.
        most: Stretches at most; longer episodes get longer ones.

    Returns:
        Counts (C, T) and how many chunks a stretch has.
    """
    width = -(-(int(made.table["chunk"].max()) + 1) // most)
    stretch = made.table["chunk"].to_numpy() // width
    counts = np.zeros((len(made.codes), int(stretch.max()) + 1), np.int64)
    np.add.at(counts, (made.table["code"].to_numpy(), stretch), 1)
    return counts, width


def transitions(made: Choices) -> Counts:
    """How often each of the first `MOST_CODES` codes (row) was followed by each (column) in the same episode."""
    most = min(len(made.codes), MOST_CODES)
    counts = np.zeros((most, most), np.int64)
    before, after = _pairs(made)
    both = (before < most) & (after < most)
    np.add.at(counts, (before[both], after[both]), 1)
    return counts


def _pairs(made: Choices) -> tuple[Counts, Counts]:
    """Codes, and those that followed them in the same episode."""
    codes, episode = made.table["code"].to_numpy(), made.table["episode"].to_numpy()
    same = episode[:-1] == episode[1:]
    return codes[:-1][same], codes[1:][same]


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
    done = actions_by_code(trace, made.size, classes)[made.codes]
    fits = action_names is not None and len(action_names) == done.shape[1]
    names = list(action_names or ()) if fits else [f"action {number}" for number in range(done.shape[1])]
    yield _actions_plot(Grid(done.T, names, made.labels, ("action", "skill code"), ""), classes > 0, sample, made)


def _usage_plot(made: Choices, sample: str) -> Plot:
    """How often each code was chosen, and in how many episodes."""
    counts, shown = made.counts, made.labels[:MOST_CODES]
    shares, codes = counts.sum(0) / counts.sum(), np.arange(len(shown))
    figure = new_figure(PAGE_WIDTH, 3.0)
    axes = figure.add_subplot()
    axes.bar(codes, 100 * shares[: len(shown)], color="0.45", edgecolor=INK, linewidth=0.4)
    axes.axhline(100 / made.size, color=INK, linestyle="--", linewidth=1, label=f"all alike: 1/{made.size}")
    if len(never := np.flatnonzero(shares == 0)):
        axes.plot(never, np.zeros(len(never)), "x", color=INK, label=f"never chosen: {len(never)}")
    axes.set(xlabel="skill code", ylabel="share of choices (%)", xlim=(-0.6, len(shown) - 0.4))
    headline(axes, f"Codes in use: perplexity {made.perplexity:.1f} of {made.size}", sample)
    names = [shorten(label, 24) for label in shown]
    axes.set_xticks(codes, names, rotation=90 if max(map(len, names)) > 4 or len(names) > 40 else 0, fontsize=7)
    axes.legend(fontsize="small")
    numbers = {"choices": counts.sum(0), "share_of_choices": shares, "share_of_episodes": made.used.mean(0)}
    reading = (
        "How often each code was chosen. Perplexity is how many codes are in effective use; good is well above 1 and "
        "few codes never chosen. Near 1 the codebook has collapsed, at the number of codes all are used alike."
    ) + made.left_out()
    return Plot("code_usage", "Codes in use", figure, pd.DataFrame({"skill_code": made.labels, **numbers}), reading)


def _over_time_plot(made: Choices, sample: str) -> Plot:
    """Share of each code in each stretch of an episode, above it how many choices that is."""
    counts, width = over_time(made)
    shares = counts / np.maximum(counts.sum(0), 1)
    stretches = [str(number * width * made.horizon) for number in range(counts.shape[1])]
    axes = ("skill code", "from step")
    grid = Grid(shares, made.labels, stretches, axes, "share of choices")
    shown = Grid(shares[:MOST_CODES], made.labels[:MOST_CODES], stretches, axes, grid.unit)
    figure = new_figure(PAGE_WIDTH, 2.1 + height(len(shown.rows)))
    above, below = figure.subplots(2, 1, height_ratios=[1, max(2.0, height(len(shown.rows)))])
    above.bar(range(counts.shape[1]), counts.sum(0), color=GREY, width=0.9)
    above.set(xlim=(-0.5, counts.shape[1] - 0.5), ylabel="choices")
    headline(above, "Code usage over time", sample)
    above.set_xticks([])
    draw_heat_map(below, shown)
    below.set(xlabel=f"step of the episode (stretches of {width * made.horizon} steps)")
    reading = (
        "Columns are stretches of an episode and sum to 1. A code that is dark only at the left starts episodes; one "
        "that is dark far right, where few episodes are left, is what the policy does when it is stuck."
    ) + made.left_out()
    table = grid.table(choices=counts, share=shares)
    return Plot("code_usage_over_time", "Code usage over time", figure, table, reading)


def _transition_plot(made: Choices, sample: str) -> Plot:
    """Which code follows which."""
    counts = transitions(made)
    shares = counts / np.maximum(counts.sum(1, keepdims=True), 1)
    labels = made.labels[: len(counts)]
    grid = Grid(shares, labels, labels, ("skill code", "next skill code"), "share of the row")
    before, after = _pairs(made)
    again = (before == after).sum() / max(1, len(before))
    reading = (
        f"Rows sum to 1. The diagonal is a code that goes on: {again:.0%} of all choices repeat the one before. Dark "
        "cells beside it are fixed sequences. One dark column is a code that everything falls back to: not good."
    ) + made.left_out()
    figure = heat_map(grid, "Next code (columns) after each code (rows)", sample)
    table = grid.table(times=counts, share=shares)
    return Plot("code_transitions", "Transitions between codes", figure, table, reading)


def _actions_plot(done: Grid, categorical: bool, sample: str, made: Choices) -> Plot:
    """What is done under each code: `actions_by_code`, turned, (A, C)."""
    unit = "share of steps" if categorical else "mean, by size"
    values = done.values[:, :MOST_CODES]
    sizes = Grid(np.abs(values), done.rows, done.columns[:MOST_CODES], done.axes, unit)
    figure = heat_map(sizes, "Actions (rows) under each code (columns)", sample)
    if not categorical:
        _write_numbers(figure.axes[0], values)
    reading = (
        "Columns sum to 1. Good is columns that differ: then codes are behaviours, not only labels of instructions."
        if categorical
        else "Mean of each action dimension, sign written in the cell, darkness its size. Good is columns that differ."
    )
    table = done.table(value=done.values)
    return Plot("actions_by_code", "Actions under each code", figure, table, reading + made.left_out())


def _write_numbers(axes: Axes, values: Numbers) -> None:
    middle = np.nanmax(np.abs(values)) / 2 if np.isfinite(values).any() else 0
    for (row, column), value in np.ndenumerate(values):
        if np.isfinite(value):
            colour = "white" if abs(value) > middle else INK
            axes.text(column, row, f"{value:+.2f}", ha="center", va="center", fontsize=5, color=colour)
