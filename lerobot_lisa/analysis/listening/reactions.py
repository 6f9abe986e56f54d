"""What a policy does differently at once when only the words change."""

from collections.abc import Iterator

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from lerobot_lisa.analysis.recording.traces import KEY
from lerobot_lisa.analysis.success.rates import success_rate


def lines(own: pd.DataFrame, other: pd.DataFrame) -> Iterator[str]:
    """First code, first action, and the way that both have in common; columns of `traces.STEPS`, same episodes."""
    first, first_other = (steps.groupby(KEY, sort=False, observed=True).first() for steps in (own, other))
    if first["code"].notna().all():
        changed = (first["code"] != first_other["code"]).tolist()
        yield f"{success_rate(changed)}  first skill code changes with the instruction"
        shares = first["code"].value_counts(normalize=True)
        yield f"{'':>9}  {100 * (1 - (shares**2).sum()):5.1f} %  of pairs of different episodes differ in it"
    yield _first_actions(np.stack(first["action"]), np.stack(first_other["action"]))
    steps = common_steps(own, other)
    yield f"{'':>9}  {np.median(steps):5.1f} steps are the same whatever is told, in half of the episodes (median)"


def common_steps(own: pd.DataFrame, other: pd.DataFrame) -> NDArray[np.int64]:
    """How many steps of each episode see and do the same in both runs, (E,)."""
    pairs = own.merge(other, on=[*KEY, "step"], suffixes=("", "_other"))
    seen = pairs["observation"] == pairs["observation_other"]
    done = [np.array_equal(a, b) for a, b in zip(pairs["action"], pairs["action_other"], strict=True)]
    same = seen & np.array(done, bool)
    return same.groupby([pairs[name] for name in KEY], observed=True).apply(lambda row: row.cummin().sum()).to_numpy()


def _first_actions(own: NDArray[np.float32], other: NDArray[np.float32]) -> str:
    """(E, A) each; categories are compared, real numbers measured in their own spread."""
    if own.shape[1] == 1 and not np.any(own % 1):
        return f"{success_rate((own != other).any(1).tolist())}  first action changes with the instruction"
    spread = np.abs(own[:, None] - own[None]).sum((0, 1)) / (len(own) * max(1, len(own) - 1))
    moved = np.abs(own - other).mean(0)
    ratio = float((moved[spread > 0] / spread[spread > 0]).mean()) if (spread > 0).any() else 0.0
    return f"{'':>9}  {100 * ratio:5.1f} %  as far apart are the first actions as those of two different episodes"
