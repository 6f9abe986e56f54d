"""How much language tells about skill codes, beside what chance gives."""

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from lerobot_lisa.analysis.figures.plot import Plot
from lerobot_lisa.analysis.figures.style import INK, PAGE_WIDTH, headline, new_figure
from lerobot_lisa.analysis.statistics.information import Information

MOST_WORDS = 60


def information_plot(asked: Mapping[str, Information], sample: str) -> Plot:
    """One panel for each question: what chance gives as a histogram, what was counted as a line.

    Args:
        asked: Mutual information by what is asked, such as "words".
        sample: What was counted, for the title.
    """
    figure = new_figure(PAGE_WIDTH, 3.0)
    figure.suptitle(f"Language-code mutual information, {sample}", fontsize=10, fontweight="bold", x=0.01, ha="left")
    for axes, (name, found) in zip(figure.subplots(1, len(asked), squeeze=False)[0], asked.items(), strict=True):
        low, high = found.interval
        style = {"color": "0.7", "edgecolor": "0.5", "linewidth": 0.4, "label": "instructions dealt anew"}
        axes.hist(found.chance, bins=30, range=_range(found), **style)
        axes.axvspan(float(low), float(high), color="0.9", zorder=0, label="95 % of chance")
        axes.axvline(float(found.bits), color=INK, linewidth=2, label=f"counted: {found.bits:.3f}")
        axes.set(title=name, xlabel="bits", ylabel="permutations", xlim=(0, None))
        axes.xaxis.set_major_locator(MaxNLocator(4))
        axes.legend(fontsize=6.5, loc="upper left", frameon=True, edgecolor="white", framealpha=1)
        axes.set_ylim(top=1.45 * axes.get_ylim()[1])  # room for the legend
    rows = [
        (name, found.bits, *found.interval, found.chance.mean(), found.p_value, found.limit, len(found.chance))
        for name, found in asked.items()
    ]
    names = ["language", "bits", "chance_low", "chance_high", "chance_mean", "p_value", "limit_bits", "permutations"]
    reading = (
        "The line is the mutual information counted, the grey hill what the same count gives when every episode gets "
        "another's instruction. Good: the line is right of the hill by much; how far is what language really says. "
        "Whole instructions tell nothing here if most occur once: then dealing them changes little."
    )
    return Plot("language_information", "What language tells about the code", figure, _frame(rows, names), reading)


def _range(found: Information) -> tuple[float, float]:
    """Of the histogram; chance may give the same each time."""
    low, high = float(found.chance.min()), float(found.chance.max())
    margin = 0.0 if high - low > 1e-6 else 1e-3
    return low - margin, high + margin


def word_information_plot(words: Sequence[str], asked: Mapping[str, Information], sample: str) -> Plot:
    """What each word tells about the code, with the 95 % of chance as a grey bar; a panel for each question."""
    first = next(iter(asked.values()))
    order = np.argsort(-first.bits, kind="stable")
    shown = order[:MOST_WORDS]
    figure = new_figure(PAGE_WIDTH, 1.3 + 0.19 * len(shown))
    for axes, (name, found) in zip(figure.subplots(1, len(asked), squeeze=False)[0], asked.items(), strict=True):
        _draw_words(axes, [words[number] for number in shown], found, shown)
        headline(axes, f"What each word tells: {name}", sample)
    rows = [
        (name, words[number], found.bits[number], low[number], high[number], found.p_value[number], found.limit[number])
        for name, found in asked.items()
        for low, high in [found.interval]
        for number in order
    ]
    names = ["codes", "word", "bits", "chance_low", "chance_high", "p_value", "limit_bits"]
    cut = f" The first {len(shown)} of {len(words)} words; the CSV has all." if len(shown) < len(words) else ""
    reading = (
        "Points right of their grey bar are words that change which skill is chosen. Good: the words that matter for "
        "the task, such as colours, things and verbs, stand out. One word in forty does so by chance alone."
    )
    return Plot("word_information", "What each word tells about the code", figure, _frame(rows, names), reading + cut)


def _draw_words(axes: Axes, names: Sequence[str], found: Information, shown: NDArray[np.int64]) -> None:
    low, high = found.interval
    lines = np.arange(len(shown))
    axes.barh(lines, (high - low)[shown], left=low[shown], color="0.85", height=0.8, label="95 % of chance")
    axes.plot(found.bits[shown], lines, "o", color=INK, markersize=4, label="counted")
    axes.set_yticks(lines, names, fontsize=8)
    axes.set(ylim=(len(shown) - 0.5, -0.5), xlim=(0, None), xlabel="bits about the code, from having the word or not")
    axes.grid(axis="x")
    axes.set_axisbelow(True)
    axes.legend(fontsize="small", loc="lower right")


def _frame(rows: Sequence[Sequence[object]], names: Sequence[str]) -> pd.DataFrame:
    return pd.DataFrame(rows, columns=list(names)).map(lambda value: value.item() if hasattr(value, "item") else value)
