"""Mutual information: known answers, bounds, and a chance that is chance."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from lerobot_lisa.analysis.skills.information import (
    entropy,
    language_information,
    mutual_information,
    one_hot,
    word_information,
)

COLOURS = ["red", "green", "blue", "grey"]


def instructions(episodes: int) -> list[str]:
    return [f"go to the {COLOURS[number % 4]} ball" for number in range(episodes)]


def test_a_bijection_gives_the_entropy() -> None:
    language = one_hot(instructions(40))
    found = language_information(language, language[:, ::-1], permutations=50)
    assert found.bits == pytest.approx(2.0)
    assert found.limit == pytest.approx(2.0)
    assert found.p_value == pytest.approx(1 / 51)


def test_an_uneven_bijection_gives_the_entropy() -> None:
    language = one_hot(["a"] * 8 + ["b"] * 4 + ["c"] * 4)
    assert language_information(language, language, permutations=20).bits == pytest.approx(1.5)


def test_independent_codes_lie_within_chance() -> None:
    rng = np.random.default_rng(0)
    inside = []
    for seed in range(40):
        codes = rng.multinomial(5, np.full(6, 1 / 6), size=60)
        found = language_information(one_hot(instructions(60)), codes, permutations=200, seed=seed)
        low, high = found.interval
        inside.append(low <= found.bits <= high)
    assert sum(inside) >= 36  # 95 % of 40 is 38


def test_independent_counts_give_nothing() -> None:
    assert mutual_information(np.outer([3, 5, 2], [1, 4])) == pytest.approx(0)


def test_one_code_tells_nothing() -> None:
    found = language_information(one_hot(instructions(12)), np.ones((12, 1)), permutations=20)
    assert found.bits == 0
    assert found.p_value == 1


def test_a_word_that_decides_the_code_tells_everything() -> None:
    """ "red" in half of the episodes, which alone use code 1; "go" is everywhere; "ball" has nothing to do with it."""
    red, go, ball = np.repeat([1, 0], 20), np.ones(40), np.tile([1, 0], 20)
    found = word_information(np.stack([red, go, ball], axis=1), np.stack([1 - red, red], axis=1), permutations=100)
    assert found.bits == pytest.approx([1, 0, 0])
    assert found.limit == pytest.approx([1, 0, 1])
    _, high = found.interval
    assert found.bits[0] > high[0]
    assert found.p_value[0] == pytest.approx(1 / 101)
    assert found.p_value[1] == 1


def test_the_same_seed_deals_the_same() -> None:
    codes = np.random.default_rng(1).multinomial(5, np.full(6, 1 / 6), size=30)
    dealt = [language_information(one_hot(instructions(30)), codes, 20, seed).chance for seed in (0, 0, 1)]
    assert (dealt[0] == dealt[1]).all()
    assert (dealt[0] != dealt[2]).any()


@given(arrays(np.int64, st.tuples(st.integers(1, 5), st.integers(1, 5)), elements=st.integers(0, 20)))
def test_between_nothing_and_both_entropies(joint: np.ndarray) -> None:
    bits = mutual_information(joint)
    assert 0 <= bits <= min(entropy(joint.sum(0)), entropy(joint.sum(1))) + 1e-9
    assert bits == pytest.approx(mutual_information(joint.T))
