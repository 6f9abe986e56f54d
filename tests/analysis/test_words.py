"""Measures of how well words and skills go together: known answers, and what never happens."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from lerobot_lisa.analysis.skills.words import contributions, lift, pointwise_information, word_table

COUNTS = arrays(np.int64, st.tuples(st.integers(1, 6), st.integers(1, 6)), elements=st.integers(0, 50))
EXCLUSIVE = np.array([[40, 0], [0, 40], [40, 40]])  # "red" with skill 0 only, "blue" with 1 only, "the" with both


def test_words_of_each_instruction() -> None:
    words, table = word_table(["Go to the ball, then go", "", "open"])
    assert words == ["ball", "go", "open", "the", "then", "to"]
    assert table.tolist() == [[1, 2, 0, 1, 1, 1], [0] * 6, [0, 0, 1, 0, 0, 0]]


def test_a_word_of_one_skill_is_twice_as_frequent_there() -> None:
    assert lift(EXCLUSIVE) == pytest.approx(np.array([[2, 0], [0, 2], [1, 1]]))


def test_pointwise_information_of_exclusive_words() -> None:
    discount = 40 / 41 * (40 / 41)
    assert pointwise_information(EXCLUSIVE) == pytest.approx(np.array([[discount, 0], [0, discount], [0, 0]]))


def test_a_word_seen_once_counts_less_than_one_seen_often() -> None:
    counts = np.array([[1, 0, 0], [0, 50, 0], [100, 51, 151]])
    information = pointwise_information(counts)
    assert lift(counts)[0, 0] > lift(counts)[1, 1] * 0.5
    assert information[0, 0] < 0.5 * information[1, 1]


@given(COUNTS)
def test_nothing_is_negative_or_undefined(counts: np.ndarray) -> None:
    for measure in (lift, pointwise_information, contributions):
        values = measure(counts)
        assert values.shape == counts.shape
        assert np.isfinite(values).all()
        assert (values >= 0).all()
        assert (values[counts == 0] == 0).all()
