"""What a report says about skills and annotations: the measures, which code for which subtask, and a few episodes."""

from collections.abc import Iterator
from itertools import groupby

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from lerobot_lisa.analysis.annotations.compare import Comparison, key_numbers
from lerobot_lisa.analysis.annotations.match import boundaries
from lerobot_lisa.analysis.drawing import (
    GREY,
    INK,
    LIGHT,
    MOST_CODES,
    PAGE_WIDTH,
    Grid,
    Plot,
    clip,
    headline,
    heat_map,
    new_figure,
)
from lerobot_lisa.analysis.material import Answer

NAME, TITLE = "annotations", "Skills and annotations"
MOST_SUBTASKS, MOST_EPISODES = 40, 12
READING = (
    "Homogeneity is 1 if every code serves one subtask only, completeness if every subtask has one code only; "
    "V-measure is their harmonic mean. The adjusted Rand index is 0 for codes that have nothing to do with subtasks. "
    "Boundaries: how many changes of code fall within {tolerance} steps of a change of subtask (precision), and how "
    "many changes of subtask within so many of a change of code (recall). Grey is 95 % of what chance gives: each "
    "episode keeps its codes, and how often they change, but in another order. The cross is what ideal codes give, one "
    "for each subtask, chosen every {horizon} steps for the subtask that most of them serve. Good is far right of the "
    "grey bar and near the cross."
)


def answer(made: Comparison) -> Answer:
    """Do codes match the subtasks of the training data?"""
    counts = made.counts
    introduction = (
        f"The training data say which subtask each step serves ({counts['subtasks']:,} different ones). Here the skill "
        f"predictor chose codes for {counts['episodes']:,} of their episodes, from what was seen in them, and nothing "
        "was trained on subtasks. Codes need not match them: a skill may well be smaller, or shared by several."
    )
    return Answer(NAME, TITLE, introduction, plots(made), numbers=key_numbers(made))


def plots(made: Comparison) -> Iterator[Plot]:
    """Measures, which code for which subtask, and episodes in which subtasks change."""
    counts = made.counts
    sample = f"{made.dataset}, n = {counts['episodes']:,} episodes, {counts['steps_annotated']:,} steps"
    yield _scores_plot(made, sample)
    yield _codes_plot(made, sample)
    changing = _changing(made)
    if changing:
        yield _episodes_plot(made, changing, sample)


def _scores_plot(made: Comparison, sample: str) -> Plot:
    """Every measure beside chance and ideal codes."""
    figure = new_figure(PAGE_WIDTH * 0.75, 3.0)
    axes, rows = figure.add_subplot(), np.arange(len(made.scores))
    low, high = np.array([score.interval for score in made.scores]).T
    values, ideal = ([getattr(score, name) for score in made.scores] for name in ("value", "ideal"))
    axes.barh(rows, high - low, left=low, color="0.85", height=0.8, label="95 % of chance")
    axes.plot(ideal, rows, "x", color=GREY, label="ideal codes")
    axes.plot(values, rows, "o", color=INK, markersize=5, label="counted")
    axes.set_yticks(rows, [score.name for score in made.scores])
    axes.set(ylim=(len(rows) - 0.5, -0.5), xlim=(min(0.0, float(np.nanmin([*low, *values, 0]))) - 0.02, 1.02))
    axes.grid(axis="x")
    axes.set_axisbelow(True)
    axes.legend(fontsize="small", loc="upper left", bbox_to_anchor=(1, 1))
    headline(axes, "Skill codes beside annotated subtasks", sample)
    table = pd.DataFrame(
        {
            "measure": [score.name for score in made.scores],
            "value": values, "chance_low": low, "chance_high": high, "ideal": ideal,
            "p_value": [score.p_value for score in made.scores],
        }
    )  # fmt: skip
    reading = READING.format(tolerance=made.settings.tolerance, horizon=made.horizon)
    return Plot("annotation_scores", "Skill codes beside annotated subtasks", figure, table, reading)


def _codes_plot(made: Comparison, sample: str) -> Plot:
    """Under which code the steps of each subtask are."""
    steps = pd.DataFrame({"subtask": made.found.subtask, "code": np.repeat(made.found.code, made.found.length)})
    counts = steps[steps["subtask"] >= 0].groupby(["subtask", "code"]).size().unstack(fill_value=0)
    counts = counts.loc[counts.sum(1).sort_values(ascending=False, kind="stable").index]
    codes = counts.sum(0).sort_values(ascending=False, kind="stable").index[:MOST_CODES].sort_values()
    shares = counts.div(counts.sum(1), axis=0)
    axes, unit = ("subtask", "skill code"), "share of the subtask's steps"
    whole = Grid(shares.to_numpy(), [made.subtasks[row] for row in shares.index],
                 [made.codes[code] for code in shares.columns], axes, unit)  # fmt: skip
    shown = shares[codes].iloc[:MOST_SUBTASKS]
    grid = Grid(shown.to_numpy(), [made.subtasks[row] for row in shown.index], [made.codes[code] for code in codes],
                axes, unit)  # fmt: skip
    figure = heat_map(grid, "Under which codes subtasks are done", sample)
    left = (
        f" The {len(shown)} longest of {len(shares):,} subtasks; the CSV has all." if len(shown) < len(shares) else ""
    )
    reading = (
        "Rows sum to 1. Good: one dark cell in a row, and few in a column; an even row is a subtask without a code."
    )
    table = whole.table(share=whole.values, steps=counts.to_numpy())
    return Plot("annotation_codes", "Under which codes subtasks are done", figure, table, reading + left)


def _changing(made: Comparison) -> list[int]:
    """The first episodes in which subtasks change."""
    episode = np.repeat(made.found.episode, made.found.length)
    return np.unique(episode[boundaries(made.found)])[:MOST_EPISODES].tolist()


def _episodes_plot(made: Comparison, episodes: list[int], sample: str) -> Plot:
    """Subtasks and codes of a few episodes, one above the other."""
    figure = new_figure(PAGE_WIDTH, 1.0 + 0.46 * len(episodes))
    axes = figure.add_subplot()
    tables = [_spans(made, episode) for episode in episodes]
    longest = max(int(table["stop"].max()) for table in tables)
    for row, table in enumerate(tables):
        for lane, spans in table.groupby("lane", sort=False):
            _draw_spans(axes, row - 0.2 if lane == "subtask" else row + 0.2, spans, longest)
    axes.set_yticks(range(len(episodes)), [f"episode {episode}" for episode in episodes], fontsize=8)
    axes.set(ylim=(len(episodes) - 0.5, -0.5), xlim=(0, longest), xlabel="step")
    headline(axes, "Subtasks (above) and skill codes (below) of episodes", sample)
    reading = (
        "The first episodes in which the subtask changes. Good: a new code where a new subtask begins, and the same "
        "code for the same subtask in other episodes."
    )
    title = "Subtasks and codes of episodes"
    return Plot("annotation_episodes", title, figure, pd.concat(tables, ignore_index=True), reading)


def _spans(made: Comparison, episode: int) -> pd.DataFrame:
    """Stretches of one subtask, and of one code, of an episode."""
    chosen = np.repeat(made.found.episode, made.found.length) == episode
    lanes = {
        "subtask": [made.subtasks[place] if place >= 0 else "" for place in made.found.subtask[chosen]],
        "code": [made.codes[code] for code in np.repeat(made.found.code, made.found.length)[chosen]],
    }
    rows = []
    for lane, texts in lanes.items():
        start = 0
        for text, steps in groupby(texts):
            stop = start + len(list(steps))
            rows.append({"episode": episode, "lane": lane, "start": start, "stop": stop, "text": text})
            start = stop
    return pd.DataFrame(rows)


def _draw_spans(axes: Axes, height: float, spans: pd.DataFrame, longest: int) -> None:
    """One lane: boxes in turn white and grey, with as much of their names as fits."""
    for number, span in enumerate(spans.itertuples()):
        width = span.stop - span.start
        shade = "white" if number % 2 else LIGHT
        axes.barh(height, width, left=span.start, height=0.38, color=shade, edgecolor=GREY, linewidth=0.5)
        letters = int(width / longest * PAGE_WIDTH * 14)
        if letters > 1 and span.text:
            name = clip(span.text, letters)
            axes.text(span.start + longest * 0.002, height, name, va="center", fontsize=6.5, clip_on=True)
