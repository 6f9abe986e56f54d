"""The search finds the best plan of a world that can be calculated."""

import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from lerobot_lisa.networks.cross_entropy import CrossEntropySearch

SEARCH = CrossEntropySearch(samples=200, elites=20, rounds=8)
BOUNDS = torch.tensor([[-1.0, -2.0], [1.0, 2.0]])


def middle(searches: int) -> Tensor:
    return torch.zeros(searches, 3, 2)


@given(x=st.floats(-1, 1), y=st.floats(-2, 2), seed=st.integers(0, 3))
def test_it_finds_the_best_plan(x: float, y: float, seed: int) -> None:
    best = torch.tensor([[x, y], [y / 2, x]])  # of two searches

    def value(plans: Tensor) -> Tensor:
        return -(plans - best[:, None, None]).square().sum((2, 3))

    found = SEARCH(value, BOUNDS, middle(2), torch.Generator().manual_seed(seed))

    assert found.shape == (2, 3, 2)
    torch.testing.assert_close(found, best[:, None].expand(2, 3, 2), atol=0.1, rtol=0)


@given(scale=st.sampled_from([-1e3, -1.0, 0.0, 1.0, 1e3]))
def test_it_stays_within_bounds(scale: float) -> None:
    found = SEARCH(lambda plans: scale * plans.sum((2, 3)), BOUNDS, middle(4))

    assert (found >= BOUNDS[0]).all()
    assert (found <= BOUNDS[1]).all()
    if scale:
        torch.testing.assert_close(found, BOUNDS[int(scale > 0)].expand_as(found), atol=0.1, rtol=0)


def test_the_same_seed_finds_the_same() -> None:
    def search(seed: int) -> Tensor:
        return SEARCH(lambda plans: plans.sum((2, 3)).cos(), BOUNDS, middle(2), torch.Generator().manual_seed(seed))

    before = torch.get_rng_state()
    assert torch.equal(search(0), search(0))
    assert not torch.equal(search(0), search(1))
    assert torch.equal(before, torch.get_rng_state())


def test_it_begins_around_a_plan() -> None:
    """With a single round of few plans, what is near the plan is found, and what is far from it is not."""
    few, best = CrossEntropySearch(samples=30, elites=5, rounds=1), torch.tensor([1.0, 2.0])

    def value(plans: Tensor) -> Tensor:
        return -(plans - best).square().sum((2, 3))

    def found(around: Tensor) -> Tensor:
        return (few(value, BOUNDS, around, torch.Generator().manual_seed(0)) - best).abs().mean()

    assert found(best.expand(8, 3, 2)) < 0.7 * found(-best.expand(8, 3, 2))
