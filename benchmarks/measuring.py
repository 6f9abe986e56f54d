"""Time taken by work, on the processor and by the clock, and rates of alternatives that run in turns."""

import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple


class Seconds(NamedTuple):
    """What some work took: `cpu` of this process with its threads, `wall` by the clock."""

    cpu: float
    wall: float

    @classmethod
    def now(cls) -> "Seconds":
        """Readings of both clocks."""
        return cls(time.process_time(), time.perf_counter())

    def since(self, start: "Seconds") -> "Seconds":
        """Difference of two readings."""
        return Seconds(self.cpu - start.cpu, self.wall - start.wall)

    def per(self, amount: float) -> "Seconds":
        """Seconds for one of `amount` things."""
        return Seconds(self.cpu / amount, self.wall / amount)


def measure(work: Callable[[], float | None]) -> Seconds:
    """Seconds for each thing that `work` says it has done; for all of it, if it says nothing."""
    start = Seconds.now()
    amount = work()
    return Seconds.now().since(start).per(1 if amount is None else amount)


@dataclass(frozen=True)
class Contest:
    """Seconds per thing of ours and of the alternative, one of each for every repeat."""

    ours: Sequence[Seconds]
    alternative: Sequence[Seconds]

    @property
    def cpu_ratio(self) -> float:
        """How many times as long the alternative takes on the processor: the median of the repeats' ratios."""
        return self._ratio("cpu")

    @property
    def wall_ratio(self) -> float:
        """The same by the clock."""
        return self._ratio("wall")

    def _ratio(self, clock: str) -> float:
        pairs = zip(self.ours, self.alternative, strict=True)
        return statistics.median(getattr(theirs, clock) / getattr(ours, clock) for ours, theirs in pairs)


def contest(
    ours: Callable[[], float | None], alternative: Callable[[], float | None], repeats: int, warm_up: bool = True
) -> Contest:
    """Run both in turns, so that what else the machine does meets both; each returns how much it has done."""
    if warm_up:
        ours()
        alternative()
    pairs = [(measure(ours), measure(alternative)) for _ in range(repeats)]
    return Contest([pair[0] for pair in pairs], [pair[1] for pair in pairs])


def middle(times: Sequence[Seconds]) -> Seconds:
    """Medians of both clocks."""
    return Seconds(statistics.median(t.cpu for t in times), statistics.median(t.wall for t in times))
