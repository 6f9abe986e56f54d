"""How much language tells about skill codes, beside what chance gives."""

from collections.abc import Sequence

import numpy as np
import pandas as pd

from lerobot_lisa.analysis.figures.plot import Plot
from lerobot_lisa.analysis.figures.style import INK, PAGE_WIDTH, headline, new_figure
from lerobot_lisa.analysis.statistics.information import Information

MOST_WORDS = 60


def information_plot(asked: dict[str, Information], sample: str) -> Plot:
    """One panel for each question: what chance gives as a histogram, what was counted as a line.

    Args:
        asked: Mutual information by what is asked, such as "words".
        sample: What was counted, for the title.
    """
    figure = new_figure(PAGE_WIDTH, 2.9)
    figure.suptitle(f"Language-code mutual information, {sample}", fontsize=10, fontweight="bold", x=0.01, ha="left")
    for axes, (name, found) in zip(figure.subplots(1, len(asked), squeeze=False)[0], asked.items(), strict=True):
        low, high = found.interval
        axes.hist(found.chance, bins=30, color="0.7", edgecolor="0.5", linewidth=0.4, label="instructions dealt anew")
        axes.axvspan(float(low), float(high), color="0.9", zorder=0, label="95 % of chance")
        axes.axvline(float(found.bits), color=INK, linewidth=2, label=f"counted: {found.bits:.3f}")
        axes.set(title=f"{name} and code", xlabel="bits", ylabel="permutations", xlim=(0, None))
        axes.legend(fontsize="small")
    rows = [
        (name, found.bits, *found.interval, found.chance.mean(), found.p_value, found.limit, len(found.chance))
        for name, found in asked.items()
    ]
    names = ["language", "bits", "chance_low", "chance_high", "chance_mean", "p_value", "limit_bits", "permutations"]
    reading = (
        "The line is the mutual information counted, the grey hill what the same count gives when every episode gets "
        "another's instruction. Good: the line is right of the hill by much; how far is what language really says. If "
        "every episode has an instruction of its own, dealing changes nothing between instruction and code, and only "
        "words can tell."
    )
    return Plot("language_information", "What language tells about the code", figure, _frame(rows, names), reading)


def word_information_plot(words: Sequence[str], found: Information, sample: str) -> Plot:
    """For each word, what it tells about the code, with the 95 % of chance as a grey bar."""
    low, high = found.interval
    order = np.argsort(-found.bits, kind="stable")
    shown = order[:MOST_WORDS]
    lines = np.arange(len(shown))
    figure = new_figure(min(PAGE_WIDTH, 7.5), 1.1 + 0.19 * len(shown))
    axes = figure.add_subplot()
    axes.barh(lines, (high - low)[shown], left=low[shown], color="0.85", height=0.8, label="95 % of chance")
    axes.plot(found.bits[shown], lines, "o", color=INK, markersize=4, label="counted")
    axes.set_yticks(lines, [words[number] for number in shown], fontsize=8)
    axes.set(
        ylim=(len(shown) - 0.5, -0.5),
        xlim=(0, None),
        xlabel="mutual information between “the instruction has the word” and the code (bits)",
    )
    headline(axes, "What each word tells about the code", sample)
    axes.grid(axis="x")
    axes.set_axisbelow(True)
    axes.legend(fontsize="small", loc="lower right")
    rows = list(zip(words, found.bits, low, high, found.p_value, found.limit, strict=True))
    table = _frame(
        [rows[number] for number in order], ["word", "bits", "chance_low", "chance_high", "p_value", "limit"]
    )
    cut = f" The first {len(shown)} of {len(words)} words; the CSV has all." if len(shown) < len(words) else ""
    reading = (
        "Points right of their grey bar are words that change which skill is chosen. Good: the words that matter for "
        "the task, such as colours, things and verbs, stand out. One word in forty does so by chance alone."
    )
    return Plot("word_information", "What each word tells about the code", figure, table, reading + cut)


def _frame(rows: Sequence[Sequence[object]], names: Sequence[str]) -> pd.DataFrame:
    return pd.DataFrame(rows, columns=list(names)).map(lambda value: value.item() if hasattr(value, "item") else value)
