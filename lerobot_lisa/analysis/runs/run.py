"""A training run as it was logged, and what to call it beside others."""

from collections.abc import Sequence
from typing import Any, NamedTuple

CURVES = (
    "action_loss", "commitment_loss", "action_accuracy", "perplexity", "codes_used", "mutual_information",
)  # fmt: skip
"""What the policies log, by the names that they log it under."""

SETTINGS = {"policy": "type", "K": "codebook_size", "H": "horizon", "seed": "seed"}
"""What runs are told apart by: how it is called in a figure, and in the configuration."""


class Run(NamedTuple):
    """One training run.

    Attributes:
        name: Its file's name.
        steps: Step of each logged line.
        values: Logged numbers by key, one for each line.
        settings: Of `SETTINGS`, by the first of their names, as far as they are logged.
    """

    name: str
    steps: list[int]
    values: dict[str, list[float]]
    settings: dict[str, Any] = {}  # noqa: RUF012  (never changed)


def labels(runs: Sequence[Run]) -> list[str]:
    """What to call each run: the settings that differ, or its file's name where those do not tell runs apart."""
    differing = [name for name in SETTINGS if len({str(run.settings.get(name)) for run in runs}) > 1]
    told = [", ".join(f"{name} {run.settings[name]}" for name in differing if name in run.settings) for run in runs]
    return [name if name and told.count(name) == 1 else run.name for run, name in zip(runs, told, strict=True)]
