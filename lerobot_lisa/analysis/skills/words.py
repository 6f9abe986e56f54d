"""Words by skill: counts as the paper takes them, measures of how well a word and a skill go together, heat maps."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lerobot_lisa.analysis.drawing import Grid, Plot, heat_map

Counts = NDArray[np.int64]
Numbers = NDArray[np.float64]
MOST_WORDS = 60
"""Rows of a heat map; more cannot be read."""
MOST_SKILLS = 100
"""Columns of a heat map: the paper's largest codebook."""


@dataclass(frozen=True)
class SkillWords:
    """How often words and skills meet.

    Attributes:
        words: W words in alphabetical order.
        counts: How often each word was in an instruction that each skill was used for, (W, K).
        labels: Of the K codes that are counted.
    """

    words: Sequence[str]
    counts: Counts
    labels: Sequence[str]


def word_table(instructions: Sequence[str]) -> tuple[list[str], Counts]:
    """W words in alphabetical order, and how often each of E instructions has each of them, (E, W)."""
    listed = [re.findall(r"\w+", instruction.lower()) for instruction in instructions]
    words = sorted({word for of_one in listed for word in of_one})
    place = {word: number for number, word in enumerate(words)}
    table = np.zeros((len(listed), len(words)), np.int64)
    for row, of_one in enumerate(listed):
        np.add.at(table[row], [place[word] for word in of_one], 1)
    return words, table


def count_words(instructions: Sequence[str], used: Counts, labels: Sequence[str]) -> SkillWords:
    """Count words by skill: each code that an episode uses gets all words of its instruction.

    So does the paper ("Generating heat maps and word clouds"), because nobody knows which words a skill stands for. A
    code that an episode uses twice gets the words once.

    Args:
        instructions: One for each of E episodes.
        used: Whether each episode used each of K codes, (E, K).
        labels: Of the codes.
    """
    words, table = word_table(instructions)
    return SkillWords(words, table.T @ used, labels)


def normalise(counts: Counts, axis: int) -> Numbers:
    """Shares along an axis of (W, K) counts: 0 gives each skill's words, 1 each word's skills. Empty lines stay 0."""
    return counts / np.maximum(counts.sum(axis=axis, keepdims=True), 1)


def lift(counts: Counts) -> Numbers:
    """How many times as frequent as usual each word is with each skill, (W, K); 0 for a word or skill without count."""
    usual = counts.sum(1, keepdims=True) / max(1, counts.sum())
    return normalise(counts, 0) / np.where(usual > 0, usual, 1)


def pointwise_information(counts: Counts) -> Numbers:
    """How surprisingly often each word and skill meet, in bits, (W, K); 0 where they meet no more often than chance.

    Positive pointwise mutual information, log2 of `lift`, does not care how frequent a word is. Pairs that were seen
    rarely are discounted as in Pantel and Lin, "Discovering word senses from text" (KDD 2002), since a word that occurs
    once fits its skill perfectly, by chance.
    """
    rarer = np.minimum(counts.sum(1, keepdims=True), counts.sum(0, keepdims=True))
    discount = counts / (counts + 1) * (rarer / (rarer + 1))
    return discount * np.log2(np.maximum(lift(counts), 1))


def contributions(counts: Counts) -> Numbers:
    """What each word adds to what a skill's words say about the skill, in bits, (W, K); 0 for words below their usual.

    The summands of the Kullback-Leibler divergence between a skill's words and all words.
    """
    return normalise(counts, 0) * np.log2(np.maximum(lift(counts), 1))


def top_words(found: SkillWords, most: int = 3) -> list[list[tuple[str, float]]]:
    """For each of K skills at most `most` words that set it apart, and how many times as frequent as usual they are.

    Ranked by how far their share among the skill's words exceeds their share among all words, so that "go" and "the",
    which nearly every instruction has, do not crowd out the others.
    """
    counts = found.counts
    shares, usual = normalise(counts, 0), counts.sum(1, keepdims=True) / max(1, counts.sum())
    ranked, times = np.argsort(usual - shares, axis=0, kind="stable")[:most], lift(counts)
    return [
        [(found.words[word], float(times[word, skill])) for word in row if times[word, skill] > 1]
        for skill, row in enumerate(ranked.T)
    ]


def notable(counts: Counts, most: int = MOST_WORDS) -> NDArray[np.int64]:
    """Rows of the words that tell most about skills, in order; all of them if there are no more than `most`."""
    telling = (counts * pointwise_information(counts)).sum(1)
    return np.sort(np.argsort(-telling, kind="stable")[:most])


def plots(found: SkillWords, sample: str) -> Iterator[Plot]:
    """The heat maps: raw, by skill and by word as in the paper's appendix, and by surprise; none without words.

    Args:
        found: What was counted.
        sample: How much was counted, for the headlines.
    """
    if not found.words:
        return
    rows, everything = notable(found.counts), _measures(found)
    cut = [f"the {len(rows)} most telling of {len(found.words):,} words"] * (len(rows) < len(found.words))
    skills = found.labels[:MOST_SKILLS]
    cut += [f"the {len(skills)} most frequent of {len(found.labels):,} skills"] * (len(skills) < len(found.labels))
    whose = f" Shown: {' and '.join(cut)}; the CSV has all." if cut else ""
    for measure, (name, title, unit, reading) in _MAPS.items():
        values = np.asarray(everything[measure], np.float64)
        shown = values[rows, : len(skills)]
        grid = Grid(shown, [found.words[row] for row in rows], skills, ("word", "skill code"), unit)
        table = Grid(values, found.words, found.labels, grid.axes, unit).table(**everything)
        yield Plot(name, title, heat_map(grid, title, sample), table, reading + whose)


def _measures(found: SkillWords) -> dict[str, NDArray]:
    return {
        "count": found.counts,
        "share_of_skill": normalise(found.counts, 0),
        "share_of_word": normalise(found.counts, 1),
        "pmi_bits": pointwise_information(found.counts),
    }


_MAPS = {
    "count": ("skill_words_counts", "How often words and skills meet", "times",
        "Each code that an episode used gets all words of its instruction, as in the paper. Dark rows are frequent "
        "words, dark columns frequent skills: read the other maps for what belongs together."),
    "share_of_skill": ("skill_words_by_skill", "Words of each skill (columns sum to 1)", "share",
        "A column is a skill's vocabulary. Columns that look alike are skills that language does not tell apart; "
        "good is a few dark cells per column, in other rows than its neighbours'."),
    "share_of_word": ("skill_words_by_word", "Skills of each word (rows sum to 1)", "share",
        "A row is where a word leads. A word that decides the skill has one dark cell, a filler such as “the” is "
        "evenly grey."),
    "pmi_bits": ("skill_words_pmi", "Words and skills that meet more often than by chance", "bits",
        "Positive pointwise mutual information, discounted for rare pairs: frequent words no longer stand out for "
        "being frequent. White is chance or less; 1 bit means twice as often as chance."),
}  # fmt: skip
