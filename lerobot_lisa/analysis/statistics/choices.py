"""Which skill codes were chosen: how often, when in an episode, and after which other."""

from dataclasses import dataclass

import numpy as np
import pandas as pd
import torch
from numpy.typing import NDArray

from lerobot_lisa.analysis.recording.traces import KEY, Trace
from lerobot_lisa.networks import codebook

Counts = NDArray[np.int64]
Numbers = NDArray[np.float64]


@dataclass(frozen=True)
class Choices:
    """Every choice that the skill predictor made in a trace: one at steps 0, H, 2H, ... of each episode.

    Attributes:
        table: One row for each choice, in order: `episode` (its row in the trace's episodes), `chunk` and `code`.
        episodes: E.
        size: K, codes in the codebook.
        horizon: H, steps that a code holds.
    """

    table: pd.DataFrame
    episodes: int
    size: int
    horizon: int

    @property
    def counts(self) -> Counts:
        """How often each episode chose each code, (E, K)."""
        counts = np.zeros((self.episodes, self.size), np.int64)
        np.add.at(counts, (self.table["episode"].to_numpy(), self.table["code"].to_numpy()), 1)
        return counts

    @property
    def used(self) -> Counts:
        """Whether each episode chose each code, (E, K)."""
        return (self.counts > 0).astype(np.int64)

    @property
    def first(self) -> Counts:
        """Whether each code was the first of each episode, (E, K)."""
        return np.eye(self.size, dtype=np.int64)[self.table["code"].to_numpy()[self.table["chunk"].to_numpy() == 0]]

    @property
    def perplexity(self) -> float:
        """How many codes are in effective use, over all choices."""
        return codebook.perplexity(torch.tensor(self.table["code"].to_numpy()), self.size).item()

    @property
    def dead(self) -> list[int]:
        """Codes that were never chosen."""
        return np.flatnonzero(self.counts.sum(0) == 0).tolist()


def choices(trace: Trace) -> Choices:
    """The choices in a trace of a policy with skill codes."""
    horizon, size = trace.facts["policy"]["horizon"], trace.facts["policy"]["codebook_size"]
    chosen = trace.steps[trace.steps["step"] % horizon == 0]
    place = pd.MultiIndex.from_frame(trace.episodes[KEY]).get_indexer(pd.MultiIndex.from_frame(chosen[KEY]))
    table = pd.DataFrame(
        {
            "episode": place,
            "chunk": (chosen["step"] // horizon).to_numpy(),
            "code": chosen["code"].to_numpy(np.int64),
        }
    )
    return Choices(table, len(trace.episodes), size, horizon)


def over_time(made: Choices, most: int = 50) -> tuple[Counts, int]:
    """How often each code was chosen in each stretch of an episode.

    Args:
        made: The choices.
        most: Stretches at most; longer episodes get longer ones.

    Returns:
        Counts (K, T) and how many chunks a stretch has.
    """
    width = -(-(int(made.table["chunk"].max()) + 1) // most)
    stretch = made.table["chunk"].to_numpy() // width
    counts = np.zeros((made.size, int(stretch.max()) + 1), np.int64)
    np.add.at(counts, (made.table["code"].to_numpy(), stretch), 1)
    return counts, width


def transitions(made: Choices) -> Counts:
    """How often each code (row) was followed by each code (column) in the same episode, (K, K)."""
    counts = np.zeros((made.size, made.size), np.int64)
    for codes in made.table.groupby("episode")["code"]:
        listed = codes[1].to_numpy()
        np.add.at(counts, (listed[:-1], listed[1:]), 1)
    return counts


def actions_by_code(trace: Trace, size: int, classes: int) -> Numbers:
    """What is done under each code.

    Args:
        trace: Of a policy with skill codes.
        size: K.
        classes: Number of different actions; 0 for real numbers.

    Returns:
        Shares of the actions (K, classes), or means of the action's numbers (K, A); nan for codes never followed.
    """
    codes, actions = trace.steps["code"].to_numpy(np.int64), np.stack(trace.steps["action"].to_list())
    values = np.eye(classes)[actions[:, 0].round().astype(np.int64)] if classes else actions.astype(np.float64)
    sums, steps = np.zeros((size, values.shape[1])), np.bincount(codes, minlength=size)[:, None]
    np.add.at(sums, codes, values)
    return np.divide(sums, steps, out=np.full_like(sums, np.nan), where=steps > 0)
