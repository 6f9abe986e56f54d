"""Words by skill: counts as the paper takes them, and measures of how well a word and a skill go together."""

import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Counts = NDArray[np.int64]
Numbers = NDArray[np.float64]


def word_table(instructions: Sequence[str]) -> tuple[list[str], Counts]:
    """W words in alphabetical order, and how often each of E instructions has each of them, (E, W)."""
    listed = [re.findall(r"\w+", instruction.lower()) for instruction in instructions]
    words = sorted({word for of_one in listed for word in of_one})
    place = {word: number for number, word in enumerate(words)}
    table = np.zeros((len(listed), len(words)), np.int64)
    for row, of_one in enumerate(listed):
        np.add.at(table[row], [place[word] for word in of_one], 1)
    return words, table


def count_words(instructions: Sequence[str], codes: Sequence[Sequence[int]], size: int) -> tuple[list[str], Counts]:
    """Count words by skill: each code that an episode uses gets all words of its instruction.

    So does the paper ("Generating heat maps and word clouds"), because nobody knows which words a skill stands for. A
    code that an episode uses twice gets the words once.

    Args:
        instructions: One for each of E episodes.
        codes: Skill codes of each episode's chunks, each below `size`.
        size: K, number of skill codes.

    Returns:
        W words in alphabetical order, and the counts (W, K).
    """
    used = np.zeros((len(instructions), size), np.int64)
    for row, of_one in zip(used, codes, strict=True):
        row[list(of_one)] = 1
    words, table = word_table(instructions)
    return words, table.T @ used


def normalise(counts: Counts, axis: int) -> Numbers:
    """Shares along an axis of (W, K) counts: 0 gives each skill's words, 1 each word's skills. Empty lines stay 0."""
    sums = counts.sum(axis=axis, keepdims=True)
    return counts / np.maximum(sums, 1)


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


def top_words(words: Sequence[str], counts: Counts, most: int = 3) -> list[list[tuple[str, float]]]:
    """For each of K skills at most `most` words that set it apart, and how many times as frequent as usual they are.

    Ranked by how far their share among the skill's words exceeds their share among all words, so that "go" and "the",
    which nearly every instruction has, do not crowd out the others.
    """
    shares, usual = normalise(counts, 0), counts.sum(1, keepdims=True) / max(1, counts.sum())
    ranked, times = np.argsort(usual - shares, axis=0, kind="stable")[:most], lift(counts)
    return [
        [(words[word], float(times[word, skill])) for word in row if times[word, skill] > 1]
        for skill, row in enumerate(ranked.T)
    ]
