"""What reports are made from, and what each question's module hands back: the two values of a report's whole trip."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import pandas as pd

from lerobot_lisa.analysis.drawing import Plot, clip
from lerobot_lisa.analysis.recording.frames import Example
from lerobot_lisa.analysis.recording.looks import Look
from lerobot_lisa.analysis.recording.traces import Trace
from lerobot_lisa.analysis.training_data import TrainingData

PERMUTATIONS = 500
POLICIES = {
    "lisa": "LISA",
    "lang_dt": "Lang-DT",
    "babyai_rnn": "BabyAI-RNN",
    "lang_bc": "Lang-BC",
    "lorel_planner": "LOReL planner",
    "kmeans_skills": "k-means skills",
}


@dataclass(frozen=True)
class Material:
    """An evaluation, and what helps to read it.

    Attributes:
        trace: Of the evaluation.
        data: Of the training: what was seen in it, and the names of actions.
        examples: Frames of chunks; there may be none.
        looks: Where each skill looked; nothing if that was not recorded, or the policy asks nothing of what it sees.
        permutations: How often instructions are dealt to other episodes, to see what chance gives.
        font: TrueType file for word clouds; None: DejaVu Sans.
    """

    trace: Trace
    data: TrainingData
    examples: Sequence[Example] = ()
    looks: Sequence[Look] = ()
    permutations: int = PERMUTATIONS
    font: Path | None = None

    @property
    def task(self) -> str:
        """What was evaluated, in a few words."""
        return clip(str(self.trace.origin["env"].get("task") or self.trace.world))

    @property
    def sample(self) -> str:
        """How much was evaluated, for titles."""
        seeds = self.trace.episodes["seed"]
        return f"{self.task}, n = {len(seeds):,} episodes, seeds {seeds.min()} to {seeds.max()}"


class Heading(NamedTuple):
    """What stands above a skill's figure.

    Attributes:
        label: The code, and its words where it has any.
        episodes: How many used it.
        share: Of all choices.
        words: That set it apart, and how many times as frequent as usual they are.
        looks: Where it looked, in words.
    """

    label: str
    episodes: int
    share: float
    words: list[tuple[str, float]]
    looks: str = ""


@dataclass(frozen=True)
class Answer:
    """A question answered: a section of the page.

    Attributes:
        name: For links.
        title: Of the section.
        introduction: A sentence or two below it.
        plots: Its figures, drawn as they are asked for, so that a hundred are never in memory together.
        headings: One for each figure where figures have headings of their own, else empty.
        as_text: Writes the figures' numbers as they also stand in the page; None: they are in the CSV only.
        numbers: For the top of the page: name, number, what it means.
    """

    name: str
    title: str
    introduction: str
    plots: Iterable[Plot] = ()
    headings: Sequence[Heading] = ()
    as_text: Callable[[pd.DataFrame], pd.DataFrame] | None = None
    numbers: Sequence[tuple[str, str, str]] = field(default_factory=tuple)
