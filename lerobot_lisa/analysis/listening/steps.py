"""How an episode's steps compare with the demonstrator's: SPL, and success within a budget of steps."""

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.stats import bootstrap

from lerobot_lisa.analysis.recording.traces import KEY, Trace

BUDGETS = (1, 2, 4)
"""Steps that an episode may take, in units of the demonstrator's."""


@dataclass(frozen=True)
class Spl:
    """Success weighted by path length (Anderson et al. 2018, arXiv:1807.06757).

    Attributes:
        episodes: Episodes that the demonstrator solves, n.
        value: Mean of success * demonstrator's steps / the greater of its and the policy's steps, 0 to 1.
        low: Lower end of its 95 % interval, from 10,000 bootstrap samples of episodes with a fixed seed.
        high: Upper end.
    """

    episodes: int
    value: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.episodes:>9}  {self.value:5.2f}    (95 % interval {self.low:.2f} to {self.high:.2f})"


def spl(steps: NDArray[np.float64], demonstrator: NDArray[np.float64]) -> Spl:
    """SPL of at least one episode.

    Args:
        steps: Until success, inf where there was none, (E,).
        demonstrator: Its steps, at least 1, (E,).
    """
    weights = demonstrator / np.maximum(steps, demonstrator)
    value = float(weights.mean())
    if len(weights) == 1:
        return Spl(1, value, value, value)
    interval = bootstrap((weights,), np.mean, n_resamples=10_000, batch=100, method="percentile", rng=0)
    low, high = interval.confidence_interval
    return Spl(len(weights), value, float(low), float(high))


def steps_to_success(trace: Trace) -> pd.Series:
    """Steps until each episode's first success, inf where there was none; by `traces.KEY`."""
    succeeded = trace.steps[trace.steps["success"]]
    first = succeeded.groupby(KEY, observed=True)["step"].min() + 1
    episodes = trace.episodes.set_index(KEY)
    known = first.reindex(episodes.index).fillna(episodes["steps"])
    return known.where(episodes["success"], np.inf).astype(float)
