"""How well skill codes match subtasks, in numbers, beside chance and beside what codes of H steps could reach."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from tqdm import tqdm

from lerobot_lisa.analysis.annotations.subtasks import Subtasks
from lerobot_lisa.analysis.recording.traces import Trace
from lerobot_lisa.errors import UserError

Places = NDArray[np.int64]
Flags = NDArray[np.bool_]
TOLERANCE = 2
V_MEASURE, F1 = "V-measure", "boundary F1"


@dataclass(frozen=True)
class Alignment:
    """Skill codes of C chunks beside the subtasks of their N steps.

    Attributes:
        episode: Of each chunk, ascending, (C,).
        length: Steps of each chunk, (C,).
        code: That each chunk follows, (C,).
        subtask: Of each step, chunk after chunk, (N,); -1: none.
    """

    episode: Places
    length: Places
    code: Places
    subtask: Places

    @property
    def first(self) -> Flags:
        """Whether a chunk is the first of its episode, (C,)."""
        return np.diff(self.episode, prepend=-1) != 0

    @property
    def followed(self) -> Flags:
        """Whether a chunk follows another code than the one before it in its episode, (C,)."""
        return ~self.first & (np.diff(self.code, prepend=-1) != 0)

    @property
    def starts(self) -> Places:
        """The step at which each chunk begins, (C,)."""
        return np.cumsum(self.length) - self.length


@dataclass(frozen=True)
class Score:
    """One number.

    Attributes:
        name: Of the measure.
        value: As counted; nan: not defined, such as a precision without any boundary.
        chance: The same for codes in another order within each episode, (P,).
        ideal: The same for one code for each subtask, chosen every H steps for what most of the H steps serve.
    """

    name: str
    value: float
    chance: NDArray[np.float64]
    ideal: float

    @property
    def interval(self) -> tuple[float, float]:
        """Between these lie 95 % of what chance gives."""
        low, high = np.quantile(self.chance, [0.025, 0.975])
        return float(low), float(high)

    @property
    def p_value(self) -> float:
        """Probability that chance gives as much (permutation test, one-sided); nan where there is no value."""
        if np.isnan(self.value):
            return float("nan")
        return float((1 + (self.chance >= self.value - 1e-9).sum()) / (1 + len(self.chance)))


def align(trace: Trace, subtasks: Subtasks) -> Alignment:
    """Lay codes, from `demonstrations.ask`, beside the subtasks of the same dataset."""
    chunks, runs = trace.steps, trace.episodes
    episode = chunks["episode"].to_numpy(np.int64)
    left = runs["steps"].to_numpy(np.int64)[episode] - chunks["step"].to_numpy(np.int64)
    frames = [np.arange(start, start + steps) for start, steps in zip(runs["start"], runs["steps"], strict=True)]
    length = np.minimum(left, trace.question_stride)
    return Alignment(episode, length, chunks["code"].to_numpy(np.int64), subtasks.frames[np.concatenate(frames)])


def score(found: Alignment, permutations: int, tolerance: int = TOLERANCE, seed: int = 0) -> list[Score]:
    """All measures of how well codes match.

    Args:
        found: Codes and subtasks.
        permutations: P; each deals an episode's codes to its chunks anew, and its changes to multiples of H.
        tolerance: Steps that a change of code may be off a change of subtask.
        seed: Of the dealing.
    """
    rng, inner = np.random.default_rng(seed), ~found.first
    ideal = _most_frequent(found)

    def dealt_codes() -> Places:
        return found.code[_order(rng, found.episode)]

    def dealt_changes() -> Flags:
        changes = np.zeros_like(inner)
        changes[inner] = found.followed[inner][_order(rng, found.episode[inner])]
        return changes

    dealt = tqdm(range(permutations), desc="dealing codes anew", unit="times", disable=None)
    chance = [_agreement(found, dealt_codes()) | _boundaries(found, dealt_changes(), tolerance) for _ in dealt]
    best = _agreement(found, ideal.code) | _boundaries(found, ideal.followed, tolerance)
    counted = _agreement(found, found.code) | _boundaries(found, found.followed, tolerance)
    return [Score(name, counted[name], np.array([each[name] for each in chance]), best[name]) for name in counted]


def _order(rng: np.random.Generator, episode: Places) -> Places:
    """Places in an order that is random within each episode."""
    return np.lexsort((rng.random(len(episode)), episode))


def _most_frequent(found: Alignment) -> Alignment:
    """The subtask that most annotated steps of each chunk serve, in the place of its code."""
    chunk = np.repeat(np.arange(len(found.length)), found.length)
    steps = pd.DataFrame({"chunk": chunk, "subtask": found.subtask}).value_counts().reset_index()
    steps.loc[steps["subtask"] < 0, "count"] = 0
    most = steps.sort_values(["chunk", "count", "subtask"], ascending=[True, False, True]).drop_duplicates("chunk")
    return Alignment(found.episode, found.length, most["subtask"].to_numpy(), found.subtask)


def _agreement(found: Alignment, code: Places) -> dict[str, float]:
    """How well codes (C,) sort the annotated steps."""
    rand, v_measure = metrics()
    told = found.subtask >= 0
    subtask, followed = found.subtask[told], np.repeat(code, found.length)[told]
    homogeneity, completeness, both = v_measure(subtask, followed)
    numbers = {"homogeneity": homogeneity, "completeness": completeness, V_MEASURE: both}
    return {**numbers, "adjusted Rand index": rand(subtask, followed)}


def metrics() -> tuple[Callable, Callable]:
    """scikit-learn's adjusted Rand index, and its homogeneity, completeness and V-measure.

    Raises:
        UserError: scikit-learn is not installed.
    """
    try:
        from sklearn.metrics import adjusted_rand_score, homogeneity_completeness_v_measure
    except ModuleNotFoundError:
        raise UserError(
            "comparing with subtasks needs scikit-learn: pip install lerobot_policy_lisa[analysis]"
        ) from None
    return adjusted_rand_score, homogeneity_completeness_v_measure


def boundaries(found: Alignment) -> Flags:
    """Whether each step serves another subtask than the one before it in its episode, (N,)."""
    return _both_told(found) & (np.diff(found.subtask, prepend=-1) != 0)


def _both_told(found: Alignment) -> Flags:
    """Whether a step and the one before it are annotated, and of one episode, (N,)."""
    told = found.subtask >= 0
    both = told & np.roll(told, 1)
    both[found.starts[found.first]] = False
    return both


def _boundaries(found: Alignment, changes: Flags, tolerance: int) -> dict[str, float]:
    """How well changes of code, flags of chunks (C,), fall together with those of subtasks."""
    apart = np.repeat(found.episode, found.length) * tolerance  # no two episodes are within reach of each other
    at = found.starts[changes]
    theirs = np.flatnonzero(boundaries(found))
    ours = at[_both_told(found)[at]]
    hits = count_pairs((ours + apart[ours]).tolist(), (theirs + apart[theirs]).tolist(), tolerance)
    precision, recall = (hits / len(each) if len(each) else np.nan for each in (ours, theirs))
    whole = len(ours) + len(theirs)
    return {"boundary precision": precision, "boundary recall": recall, F1: 2 * hits / whole if whole else np.nan}


def count_pairs(ours: list[int], theirs: list[int], tolerance: int) -> int:
    """How many ascending places can be paired with places at most `tolerance` off, each once; the most there are."""
    pairs = i = j = 0
    while i < len(ours) and j < len(theirs):
        if abs(ours[i] - theirs[j]) <= tolerance:
            pairs, i, j = pairs + 1, i + 1, j + 1
        elif ours[i] < theirs[j]:
            i += 1
        else:
            j += 1
    return pairs
