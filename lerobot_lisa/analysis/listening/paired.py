"""The difference of two success rates of the same episodes, with its uncertainty."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot, sqrt

from lerobot_lisa.analysis.success.rates import success_rate


@dataclass(frozen=True)
class Difference:
    """How much more often the first of two runs of the same episodes succeeded.

    Attributes:
        episodes: Pairs, n.
        points: Success rate of the first run minus that of the second, in points of a percent, -100 to 100.
        low: Lower end of Newcombe's 95 % interval for paired proportions, in points.
        high: Upper end.
    """

    episodes: int
    points: float
    low: float
    high: float

    def __str__(self) -> str:
        interval = f"95 % interval {self.low:.1f} to {self.high:.1f}"
        return f"{self.episodes:>9}  {self.points:5.1f} points  ({interval})"


def difference(first: Sequence[bool], second: Sequence[bool]) -> Difference:
    """Difference of two runs' success rates, of at least one pair, in the same order.

    Newcombe's method 10 (R. G. Newcombe, Statistics in Medicine 17, 1998) puts two Wilson intervals together, closer
    for runs that agree. Unlike the usual plus-minus it holds where all episodes succeed, or all agree. Neither scipy
    nor a released statsmodels (0.15) has it.
    """
    one, two = success_rate(first), success_rate(second)
    agreement = _agreement(first, second)
    below = _side(one.percent - one.low, two.high - two.percent, agreement)
    above = _side(one.high - one.percent, two.percent - two.low, agreement)
    points = one.percent - two.percent
    return Difference(one.episodes, points, points - below, points + above)


def _side(own: float, other: float, agreement: float) -> float:
    """One side of the interval, from the distances of two Wilson limits: square, correct, add."""
    return sqrt(max(0.0, hypot(own, other) ** 2 - 2 * agreement * own * other))


def _agreement(first: Sequence[bool], second: Sequence[bool]) -> float:
    """The correlation of paired outcomes, corrected for continuity where positive; 0 where one run is constant."""
    pairs = list(zip(first, second, strict=True))
    both, only_first, only_second, neither = (
        pairs.count(kind) for kind in ((True, True), (True, False), (False, True), (False, False))
    )
    margins = (both + only_first) * (only_second + neither) * (both + only_second) * (only_first + neither)
    if not margins:
        return 0.0
    excess = both * neither - only_first * only_second
    return (max(0.0, excess - len(pairs) / 2) if excess > 0 else excess) / sqrt(margins)
