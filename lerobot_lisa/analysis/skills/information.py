"""How much instructions tell about skill codes, in bits, and how much they would seem to tell by chance.

Mutual information counted from few episodes is never 0, not even between things that have nothing to do with each
other. What it is then is found by giving every episode the instruction of another one, many times.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray
from scipy.special import xlogy

from lerobot_lisa.analysis.drawing import INK, PAGE_WIDTH, Plot, clip, headline, new_figure

Counts = NDArray[Any]
Numbers = NDArray[np.float64]
MOST_WORDS = 60


@dataclass(frozen=True)
class Information:
    """Mutual information beside what chance gives.

    Attributes:
        bits: As counted; a number, or one for each of several questions, (Q,).
        chance: The same with instructions dealt anew, (P,) or (P, Q).
        limit: What no mutual information here can exceed: the smaller of both entropies.
    """

    bits: Numbers
    chance: Numbers
    limit: Numbers

    @property
    def interval(self) -> tuple[Numbers, Numbers]:
        """Between these lie 95 % of what chance gives."""
        low, high = np.quantile(self.chance, [0.025, 0.975], axis=0)
        return low, high

    @property
    def p_value(self) -> Numbers:
        """Probability that chance gives as much (permutation test, one-sided)."""
        reached = self.chance >= self.bits - 1e-9
        return (1 + reached.sum(0)) / (1 + len(self.chance))


def entropy(counts: Numbers) -> Numbers:
    """Entropy in bits over the last dimension of counts (..., N)."""
    shares = counts / np.maximum(counts.sum(-1, keepdims=True), 1)
    return -xlogy(shares, shares).sum(-1) / np.log(2)


def mutual_information(joint: Numbers) -> Numbers:
    """Mutual information in bits of joint counts (..., N, K)."""
    together = entropy(joint.reshape(*joint.shape[:-2], joint.shape[-2] * joint.shape[-1]))
    return np.maximum(entropy(joint.sum(-1)) + entropy(joint.sum(-2)) - together, 0)


def language_information(language: Counts, codes: Counts, permutations: int, seed: int = 0) -> Information:
    """Mutual information between language and skill codes, one number for both as a whole.

    Args:
        language: What each of E episodes was told, as counts (E, N): which instruction, or which words.
        codes: How often each episode used each of K codes, (E, K).
        permutations: P.
        seed: Of the dealing.
    """
    joint = _joint(language, codes)
    limit = np.minimum(entropy(joint.sum(1)), entropy(joint.sum(0)))
    return _beside_chance(lambda dealt: mutual_information(_joint(dealt, codes)), language, permutations, seed, limit)


def word_information(presence: Counts, used: Counts, permutations: int, seed: int = 0) -> Information:
    """For each word, mutual information between "the instruction has it" and the code, over pairs (episode, its code).

    Args:
        presence: Whether each of E instructions has each of W words, (E, W).
        used: Whether each episode used each of K codes, (E, K).
        permutations: P.
        seed: Of the dealing.

    Returns:
        With one number for each word.
    """

    def tables(dealt: Counts) -> Numbers:
        present = _joint(dealt, used)
        return np.stack([present, used.sum(0) - present], axis=1)  # (W, 2, K)

    limit = np.minimum(entropy(tables(presence).sum(2)), entropy(used.sum(0)))
    return _beside_chance(lambda dealt: mutual_information(tables(dealt)), presence, permutations, seed, limit)


def one_hot(instructions: list[str]) -> Counts:
    """Which of the different instructions each of E episodes was told, (E, N)."""
    numbers, different = pd.factorize(np.array(instructions, dtype=object))
    return np.eye(len(different), dtype=np.int64)[numbers]


def _joint(language: Counts, codes: Counts) -> Numbers:
    return language.T.astype(np.float64) @ codes.astype(np.float64)  # integers would be multiplied without BLAS


def _beside_chance(
    ask: Callable[[Counts], Numbers], language: Counts, permutations: int, seed: int, limit: Numbers
) -> Information:
    """Whole instructions change places, so that what belongs together within an episode stays together."""
    rng = np.random.default_rng(seed)
    chance = np.array([ask(rng.permutation(language)) for _ in range(permutations)])
    return Information(ask(language), chance, limit)


def information_plot(asked: Mapping[str, Information], sample: str) -> Plot:
    """One panel for each question: what chance gives as a histogram, what was counted as a line.

    Args:
        asked: Mutual information by what is asked, such as "words".
        sample: What was counted, for the title.
    """
    figure = new_figure(PAGE_WIDTH, 3.0)
    figure.suptitle(f"Language-code mutual information, {sample}", fontsize=10, fontweight="bold", x=0.01, ha="left")
    for axes, (name, found) in zip(figure.subplots(1, len(asked), squeeze=False)[0], asked.items(), strict=True):
        _draw_chance(axes, found)
        axes.set_title(name)
    reading = (
        "The line is the mutual information counted, the grey hill what the same count gives when every episode gets "
        "another's instruction. Good: the line is right of the hill by much; how far is what language really says. "
        "Whole instructions tell nothing here if most occur once: then dealing them changes little."
    )
    rows = [
        {"language": name, **_numbers(found), "permutations": len(found.chance)}
        for name, found in asked.items()
    ]  # fmt: skip
    return Plot("language_information", "What language tells about the code", figure, pd.DataFrame(rows), reading)


def _numbers(found: Information) -> dict[str, Any]:
    low, high = found.interval
    return {
        "bits": found.bits, "chance_low": low, "chance_high": high, "chance_mean": found.chance.mean(0),
        "p_value": found.p_value, "limit_bits": found.limit,
    }  # fmt: skip


def _draw_chance(axes: Axes, found: Information) -> None:
    low, high = float(found.chance.min()), float(found.chance.max())
    margin = 0.0 if high - low > 1e-6 else 1e-3  # chance may give the same each time
    style: dict[str, Any] = {"color": "0.7", "edgecolor": "0.5", "linewidth": 0.4, "label": "instructions dealt anew"}
    axes.hist(found.chance, bins=30, range=(low - margin, high + margin), **style)
    axes.axvspan(*map(float, found.interval), color="0.9", zorder=0, label="95 % of chance")
    axes.axvline(float(found.bits), color=INK, linewidth=2, label=f"counted: {found.bits:.3f}")
    axes.set(xlabel="bits", ylabel="permutations", xlim=(0, None))
    axes.xaxis.set_major_locator(MaxNLocator(4))
    axes.legend(fontsize=6.5, loc="upper left", frameon=True, edgecolor="white", framealpha=1)
    axes.set_ylim(top=1.45 * axes.get_ylim()[1])  # room for the legend


def word_plots(words: Sequence[str], asked: Mapping[str, Information], sample: str) -> Iterator[Plot]:
    """What each word tells about the code, with the 95 % of chance as a grey bar; nothing if there are no words.

    Args:
        words: W words.
        asked: Their information by what is asked, a panel for each.
        sample: What was counted, for the titles.
    """
    if not words:
        return
    order = np.argsort(-next(iter(asked.values())).bits, kind="stable")
    shown = order[:MOST_WORDS]
    figure = new_figure(PAGE_WIDTH, 1.3 + 0.19 * len(shown))
    for axes, (name, found) in zip(figure.subplots(1, len(asked), squeeze=False)[0], asked.items(), strict=True):
        _draw_words(axes, [clip(words[number]) for number in shown], found, shown)
        headline(axes, f"What each word tells: {name}", sample)
    tables = [
        pd.DataFrame({"codes": name, "word": list(words), **_numbers(found)}).drop(columns="chance_mean").iloc[order]
        for name, found in asked.items()
    ]
    cut = f" The first {len(shown)} of {len(words)} words; the CSV has all." if len(shown) < len(words) else ""
    reading = (
        "Points right of their grey bar are words that change which skill is chosen. Good: the words that matter for "
        "the task, such as colours, things and verbs, stand out. One word in forty does so by chance alone."
    )
    yield Plot("word_information", "What each word tells about the code", figure, pd.concat(tables), reading + cut)


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
