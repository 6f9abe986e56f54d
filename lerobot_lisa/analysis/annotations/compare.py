"""Asks a policy about annotated demonstrations, and compares its skill codes with their subtasks."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lerobot_lisa.analysis.annotations.match import (
    F1,
    TOLERANCE,
    V_MEASURE,
    Alignment,
    Score,
    align,
    boundaries,
    metrics,
    score,
)
from lerobot_lisa.analysis.annotations.subtasks import SUBTASK, read_subtasks
from lerobot_lisa.analysis.recording.demonstrations import ask, load
from lerobot_lisa.analysis.recording.evaluation import CheckpointConfig
from lerobot_lisa.errors import UserError

if TYPE_CHECKING:
    from lerobot.datasets.lerobot_dataset import LeRobotDataset


@dataclass(frozen=True)
class Settings:
    """What is compared.

    Attributes:
        n_episodes: The first ones of the dataset.
        permutations: To see what chance gives.
        tolerance: Steps that a change of code may be off a change of subtask.
        style: LeRobot's, of annotations that last until the next one.
    """

    n_episodes: int
    permutations: int
    tolerance: int = TOLERANCE
    style: str = SUBTASK


@dataclass(frozen=True)
class Comparison:
    """Skill codes beside subtasks.

    Attributes:
        scores: All measures.
        found: Codes and subtasks.
        subtasks: What those are called.
        codes: What the K codes are called.
        horizon: H.
        settings: What was compared.
        dataset: Its folder's name.
    """

    scores: list[Score]
    found: Alignment
    subtasks: list[str]
    codes: list[str]
    horizon: int
    settings: Settings
    dataset: str

    def __getitem__(self, name: str) -> Score:
        """A measure by its name."""
        return next(score for score in self.scores if score.name == name)

    @property
    def counts(self) -> dict[str, Any]:
        """How much was compared."""
        told = self.found.subtask >= 0
        return {
            "episodes": int(self.found.first.sum()),
            "steps": len(told),
            "steps_annotated": int(told.sum()),
            "subtasks": len(np.unique(self.found.subtask[told])),
            "codes_used": len(np.unique(self.found.code)),
            "changes_of_subtask": int(boundaries(self.found).sum()),
            "changes_of_code": int(self.found.followed.sum()),
            "horizon": self.horizon,
        }


def compare(config: CheckpointConfig, dataset: "LeRobotDataset", settings: Settings) -> Comparison:
    """Ask a policy about annotated demonstrations.

    Raises:
        UserError: The dataset has no such annotations or always the same one, or the policy cannot be asked.
    """
    metrics()  # before everything that takes its time
    subtasks = read_subtasks(dataset.meta, settings.style)
    policy, preprocess = load(config, dataset)
    trace = ask(policy, preprocess, dataset, most=settings.n_episodes)
    found = align(trace, subtasks)
    if len(np.unique(found.subtask[found.subtask >= 0])) < 2:
        raise UserError(
            f"{dataset.root}: its first {found.first.sum():,} episodes hold fewer than two different annotations of "
            f"style {settings.style}: there is nothing to compare codes with"
        )
    scores = score(found, settings.permutations, settings.tolerance)
    return Comparison(
        scores, found, subtasks.labels, trace.code_labels, trace.question_stride, settings, Path(str(dataset.root)).name
    )


def as_json(made: Comparison) -> Mapping[str, Any]:
    """The numbers, JSON values; what is not defined is null."""
    scores = {
        each.name: {
            "value": _number(each.value),
            "chance_mean": _number(float(each.chance.mean())),
            "chance_low": _number(each.interval[0]),
            "chance_high": _number(each.interval[1]),
            "p_value": _number(each.p_value),
            "ideal": _number(each.ideal),
        }
        for each in made.scores
    }
    return {"dataset": made.dataset, **vars(made.settings), **made.counts, "scores": scores}


def _number(value: float) -> float | None:
    return round(value, 6) if np.isfinite(value) else None


def lines(made: Comparison) -> Iterator[str]:
    """The numbers for people."""
    counts = made.counts
    yield (
        f"{counts['episodes']:,} episodes of {made.dataset}, {counts['steps_annotated']:,} of {counts['steps']:,} "
        f"steps annotated, {counts['subtasks']:,} subtasks, {counts['codes_used']:,} codes; subtasks change "
        f"{counts['changes_of_subtask']:,} times, codes {counts['changes_of_code']:,} times"
    )
    for each in made.scores:
        low, high = each.interval
        yield f"{each.value:6.3f}  {each.name}; chance {low:.3f} to {high:.3f}; ideal codes {each.ideal:.3f}"


def key_numbers(made: Comparison) -> list[tuple[str, str, str]]:
    """For the top of a report: name, number, what it means."""
    named = {V_MEASURE: "Codes match subtasks", F1: "Codes change with subtasks"}
    return [
        (
            title,
            f"{made[name].value:.2f}",
            f"{name}; chance gives up to {made[name].interval[1]:.2f}, ideal codes {made[name].ideal:.2f}",
        )
        for name, title in named.items()
        if np.isfinite(made[name].value)
    ]
