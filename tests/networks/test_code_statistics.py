"""Statistics of skill codes on answers that are known."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from lerobot_lisa.networks.code_statistics import codes_used, mutual_information, perplexity

SIZE = 6


def distances_to(codes: Tensor, far: float) -> Tensor:
    """Squared distances of embeddings that lie on their codes, all other codes being `far` away."""
    distances = torch.full((len(codes), SIZE), far)
    distances[torch.arange(len(codes)), codes] = 0
    return distances


def test_mutual_information_of_a_bijection_is_all_bits() -> None:
    codes = torch.arange(SIZE).repeat(4)

    assert mutual_information(distances_to(codes, 200.0)).item() == pytest.approx(math.log2(SIZE), abs=1e-5)


def test_mutual_information_of_one_code_or_no_choice_is_zero() -> None:
    assert mutual_information(distances_to(torch.zeros(9, dtype=torch.long), 200.0)).item() == pytest.approx(
        0, abs=1e-6
    )
    assert mutual_information(torch.zeros(9, SIZE)).item() == pytest.approx(0, abs=1e-6)
    same = torch.rand(1, SIZE).repeat(9, 1)  # whatever is said, the same distribution
    assert mutual_information(same).item() == pytest.approx(0, abs=1e-6)


def test_mutual_information_by_hand() -> None:
    """Two embeddings, two codes, probabilities 3/4 and 1/4: 1 bit minus H(1/4)."""
    distances = torch.tensor([[0.0, 2 * math.log(3)], [2 * math.log(3), 0.0]])
    entropy = -(0.75 * math.log2(0.75) + 0.25 * math.log2(0.25))

    assert mutual_information(distances).item() == pytest.approx(1 - entropy, abs=1e-6)


@given(st.sampled_from([0.0, 1e-30, 1e4, 1e10, 1e30, 3e38]), st.integers(1, 8))
def test_mutual_information_is_finite_at_any_distance(far: float, rows: int) -> None:
    information = mutual_information(distances_to(torch.arange(rows) % SIZE, far)).item()

    assert -1e-5 <= information <= math.log2(SIZE) + 1e-5


@given(st.lists(st.integers(0, SIZE - 1), min_size=1, max_size=40))
def test_perplexity_counts_codes_in_use(codes: list[int]) -> None:
    value = perplexity(torch.tensor(codes), SIZE).item()
    assert codes_used(torch.tensor(codes, dtype=torch.int64), SIZE) == len(set(codes))

    assert 1 - 1e-5 <= value <= len(set(codes)) + 1e-4


def test_perplexity_on_known_frequencies() -> None:
    assert perplexity(torch.tensor([3, 3, 3]), SIZE).item() == 1
    assert perplexity(torch.arange(SIZE), SIZE).item() == pytest.approx(SIZE)
    assert perplexity(torch.tensor([0, 0, 1, 2]), SIZE).item() == pytest.approx(2**1.5)
