"""The heat maps of words by skill: raw, by skill and by word as in the paper's appendix, and by surprise."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from lerobot_lisa.analysis.figures.heat_map import CELL, draw_heat_map, heat_map, long_table
from lerobot_lisa.analysis.figures.plot import Plot
from lerobot_lisa.analysis.figures.style import new_figure, styled, write_png
from lerobot_lisa.analysis.statistics.words import normalise, pointwise_information

Counts = NDArray[np.int64]
MOST_WORDS = 60
"""Rows of a heat map; more cannot be read."""


def notable(words: Sequence[str], counts: Counts, most: int = MOST_WORDS) -> tuple[list[str], Counts]:
    """The words that tell most about skills, in alphabetical order, if there are more than `most`."""
    if len(words) <= most:
        return list(words), counts
    telling = (counts * pointwise_information(counts)).sum(1)
    kept = np.sort(np.argsort(-telling, kind="stable")[:most])
    return [words[word] for word in kept], counts[kept]


def draw(words: Sequence[str], counts: Counts, title: str, output: Path) -> None:
    """Draw the paper's three heat maps side by side, as PNG.

    Args:
        words: W words, the rows.
        counts: (W, K) how often each word was in an instruction that each skill was used for.
        title: What was counted.
        output: PNG file to write; the same counts give the same picture.
    """
    with styled():
        words, counts = notable(words, counts)
        rows, columns = counts.shape
        figure = new_figure(3 * max(4.0, 0.24 * columns + 1.8), max(3.0, CELL * rows + 1.4))
        figure.suptitle(title)
        for place, (name, values, unit) in enumerate(_paper_maps(counts), start=1):
            axes = figure.add_subplot(1, 3, place)
            draw_heat_map(axes, values, words, _codes(columns), unit)
            axes.set(title=name, xlabel="skill code")
        write_png(figure, output)


def _paper_maps(counts: Counts) -> list[tuple[str, NDArray[np.float64], str]]:
    return [
        ("How often", counts.astype(np.float64), "words"),
        ("Words of each skill (columns sum to 1)", normalise(counts, 0), "share"),
        ("Skills of each word (rows sum to 1)", normalise(counts, 1), "share"),
    ]


def plots(words: Sequence[str], counts: Counts, sample: str) -> list[Plot]:
    """The four heat maps for a report.

    Args:
        words: W words.
        counts: (W, K), as `count_words` counts them.
        sample: What was counted, for the headlines.
    """
    shown, kept = notable(words, counts)
    whose = (
        "" if len(shown) == len(words) else f" The {len(shown)} most telling of {len(words)} words; the CSV has all."
    )
    information = pointwise_information(counts)
    everything = _table(words, counts)
    readings = {
        "skill_words_counts": ("How often words and skills meet", counts.astype(float), "times",
            "Each code that an episode used gets all words of its instruction, as in the paper. Dark rows are frequent "
            "words, dark columns frequent skills: read the other maps for what belongs together."),
        "skill_words_by_skill": ("Words of each skill (columns sum to 1)", normalise(counts, 0), "share",
            "A column is a skill's vocabulary. Columns that look alike are skills that language does not tell apart; "
            "good is a few dark cells per column, in other rows than its neighbours'."),
        "skill_words_by_word": ("Skills of each word (rows sum to 1)", normalise(counts, 1), "share",
            "A row is where a word leads. A word that decides the skill has one dark cell, a filler such as “the” is "
            "evenly grey."),
        "skill_words_pmi": ("Words and skills that meet more often than by chance", information, "bits",
            "Positive pointwise mutual information, discounted for rare pairs: frequent words no longer stand out for "
            "being frequent. White is chance or less; 1 bit means twice as often as chance."),
    }  # fmt: skip
    place = {word: number for number, word in enumerate(words)}
    rows = [place[word] for word in shown]
    return [
        Plot(
            name,
            title,
            heat_map(values[rows], shown, _codes(kept.shape[1]), ("word", "skill code"), unit, title, sample),
            everything,
            reading + whose,
        )
        for name, (title, values, unit, reading) in readings.items()
    ]


def _codes(size: int) -> list[str]:
    return [str(code) for code in range(size)]


def _table(words: Sequence[str], counts: Counts) -> pd.DataFrame:
    measures = {
        "count": counts,
        "share_of_skill": normalise(counts, 0),
        "share_of_word": normalise(counts, 1),
        "pmi_bits": pointwise_information(counts),
    }
    return long_table(measures, words, _codes(counts.shape[1]), ("word", "skill_code"))
