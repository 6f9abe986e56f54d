"""How much instructions tell about skill codes, in bits, and how much they would seem to tell by chance.

Mutual information counted from few episodes is never 0, not even between things that have nothing to do with each
other. What it is then is found by giving every episode the instruction of another one, many times.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import xlogy

Counts = NDArray[Any]
Numbers = NDArray[np.float64]
PERMUTATIONS = 500


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
    together = entropy(joint.reshape(*joint.shape[:-2], -1))
    return np.maximum(entropy(joint.sum(-1)) + entropy(joint.sum(-2)) - together, 0)


def language_information(
    language: Counts, codes: Counts, permutations: int = PERMUTATIONS, seed: int = 0
) -> Information:
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


def word_information(presence: Counts, used: Counts, permutations: int = PERMUTATIONS, seed: int = 0) -> Information:
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
    _, numbers = np.unique(np.array(instructions, dtype=object).astype(str), return_inverse=True)
    return np.eye(numbers.max() + 1, dtype=np.int64)[numbers]


def _joint(language: Counts, codes: Counts) -> Numbers:
    return language.T.astype(np.float64) @ codes.astype(np.float64)  # integers would be multiplied without BLAS


def _beside_chance(
    ask: Callable[[Counts], Numbers], language: Counts, permutations: int, seed: int, limit: Numbers
) -> Information:
    chance = np.array([ask(dealt) for dealt in _deal(language, permutations, seed)])
    return Information(ask(language), chance, limit)


def _deal(language: Counts, permutations: int, seed: int) -> Iterator[Counts]:
    """Whole instructions change places, so that what belongs together within an episode stays together."""
    rng = np.random.default_rng(seed)
    for _ in range(permutations):
        yield rng.permutation(language)
