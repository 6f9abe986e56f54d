"""Numbers of listening, on known answers: paired differences, SPL, budgets."""

from random import Random

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lerobot_lisa.analysis.listening.heard import listening
from lerobot_lisa.analysis.listening.paired import Difference, difference
from lerobot_lisa.analysis.listening.steps import BUDGETS, spl, steps_to_success
from lerobot_lisa.analysis.recording.traces import Trace

COUNTS = st.tuples(*[st.integers(0, 60)] * 4).filter(any)


def of(both: int, only_first: int, only_second: int, neither: int) -> Difference:
    first = [True] * (both + only_first) + [False] * (only_second + neither)
    second = [True] * both + [False] * only_first + [True] * only_second + [False] * neither
    return difference(first, second)


@pytest.mark.parametrize(
    ("counts", "points", "low", "high"),
    [
        ((1, 1, 7, 12), -28.6, -50.7, -2.6),  # airways before and after a transplant, Fagerland et al. 2014
        ((14, 5, 0, 22), 12.2, 1.1, 22.6),  # Altman et al., Statistics with Confidence, table 6.2
        ((36, 12, 2, 0), 20.0, 5.7, 34.0),  # Newcombe 1998
    ],
)
def test_published_examples(counts: tuple[int, int, int, int], points: float, low: float, high: float) -> None:
    found = of(*counts)

    assert (round(found.points, 1), round(found.low, 1), round(found.high, 1)) == (points, low, high)


@given(COUNTS)
def test_the_interval_holds_the_difference_and_stays_in_range(counts: tuple[int, int, int, int]) -> None:
    found = of(*counts)
    both, only_first, only_second, neither = counts

    assert found.episodes == sum(counts)
    assert found.points == pytest.approx(100 * (only_first - only_second) / sum(counts))
    assert -100 - 1e-9 <= found.low <= found.points + 1e-9
    assert found.points - 1e-9 <= found.high <= 100 + 1e-9
    turned = of(both, only_second, only_first, neither)
    assert (turned.low, turned.high) == pytest.approx((-found.high, -found.low))


@given(COUNTS)
def test_four_times_the_pairs_make_it_narrower(counts: tuple[int, int, int, int]) -> None:
    few, many = of(*counts), of(*(4 * count for count in counts))

    assert many.high - many.low < few.high - few.low


def test_runs_that_agree_are_known_better_than_runs_that_do_not() -> None:
    agreeing, crossing = of(50, 0, 0, 50), of(0, 50, 50, 0)

    assert agreeing.points == crossing.points == 0
    assert agreeing.high - agreeing.low < 4
    assert crossing.high - crossing.low > 25


def test_it_covers_the_truth_about_as_often_as_it_says() -> None:
    """Two runs of 60 episodes whose outcomes are correlated, true difference 30 points."""
    random, covered = np.random.default_rng(0), []
    for _ in range(400):
        draws = random.choice(4, 60, p=(0.3, 0.4, 0.1, 0.2))
        found = difference((draws < 2).tolist(), (draws % 2 == 0).tolist())
        covered.append(found.low <= 30 <= found.high)
    assert 0.92 <= np.mean(covered) <= 0.98


STEPS = st.lists(st.tuples(st.one_of(st.integers(1, 200), st.just(np.inf)), st.integers(1, 50)), min_size=1)


@given(STEPS)
def test_spl_lies_between_none_and_the_success_rate(listed: list[tuple[float, int]]) -> None:
    steps, demonstrator = np.array(listed, float).T

    found = spl(steps, demonstrator)

    assert 0 <= found.low <= found.value + 1e-12
    assert found.value <= np.isfinite(steps).mean() + 1e-12
    assert found.value - 1e-12 <= found.high <= 1
    assert spl(steps, demonstrator) == found  # the same numbers every time
    assert spl(demonstrator, demonstrator).value == 1


def test_spl_on_a_known_answer() -> None:
    """As fast as the demonstrator, faster, half as fast, never."""
    found = spl(np.array([4.0, 2, 8, np.inf]), np.array([4.0, 4, 4, 4]))

    assert found.value == pytest.approx((1 + 1 + 0.5 + 0) / 4)


@given(STEPS, st.randoms(use_true_random=False))
def test_more_steps_never_mean_less_success(listed: list[tuple[float, int]], random: Random) -> None:
    steps, demonstrator = np.array(listed, float).T
    otherwise = np.array([random.choice([step, np.inf]) for step in steps])
    success = np.isfinite(steps)
    pairs = pd.DataFrame({"success": success, "steps": steps, "demonstrator": demonstrator})
    pairs = pairs.assign(told_otherwise=np.isfinite(otherwise).astype(float), steps_otherwise=otherwise)

    found = listening(pairs)

    assert found.budgets is not None
    rates = [found.budgets[budget].success.successes for budget in BUDGETS]
    assert rates == sorted(rates)
    assert rates[-1] <= found.success.successes == success.sum()
    assert rates[0] == (steps <= demonstrator).sum()
    for comparison in (found, *found.budgets.values()):
        assert comparison.heard is not None
        assert comparison.told_otherwise is not None
        assert comparison.heard.points == pytest.approx(
            comparison.success.percent - comparison.told_otherwise.percent, abs=1e-9
        )


def test_steps_end_with_the_first_success() -> None:
    """Some environments go on after it."""
    rows = [(0, 0, False), (0, 1, True), (0, 2, False), (1, 0, False), (1, 1, False), (2, 0, False)]
    steps = pd.DataFrame(rows, columns=["episode", "step", "success"]).assign(group="doors", task_id=0)
    episodes = pd.DataFrame({"episode": [0, 1, 2], "steps": [3, 2, 1], "success": [True, False, True]})

    found = steps_to_success(Trace(steps, episodes.assign(group="doors", task_id=0), {}))

    assert list(found) == [2, np.inf, 1]  # the last one's success came with the step that LeRobot counts after the end
