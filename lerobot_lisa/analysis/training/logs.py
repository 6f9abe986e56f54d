"""A training run as `lerobot-train` logged it to standard error, and what to call it beside others.

wandb's files are not read: LeRobot sends wandb the numbers of the same lines, wandb draws them itself, and the format
of its files is its own affair.
"""

import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from lerobot_lisa.analysis.material import POLICIES
from lerobot_lisa.errors import UserError

CURVES = {
    "action_loss": "Action loss (per frame)",
    "commitment_loss": "Commitment loss",
    "action_accuracy": "Demonstrated action most probable (share)",
    "perplexity": "Skill codes in effective use (perplexity)",
    "codes_used": "Skill codes used in a batch",
    "mutual_information": "Language-code mutual information (bits)",
    "model_loss": "Loss of the planner's model (per frame)",
    "judge_loss": "Loss of the planner's judge",
    "judge_accuracy": "Right answers of the judge (share)",
}
"""What the policies log, by the names that they log it under."""

SETTINGS = {"policy": "type", "K": "codebook_size", "H": "horizon", "seed": "seed"}
"""What runs are told apart by: how it is called in a figure, and in the configuration."""

_NUMBER = re.compile(r"(\w+):(-?[\d.]+(?:e[-+]?\d+)?)(?= |$)")


class Run(NamedTuple):
    """One training run.

    Attributes:
        name: Its file's name.
        steps: Step of each logged line.
        values: Logged numbers by key, one for each line; NaN where it has none, as of codes that are not yet placed.
        settings: Of `SETTINGS`, by the first of their names, as far as they are logged.
    """

    name: str
    steps: list[int]
    values: dict[str, list[float]]
    settings: dict[str, Any] = {}  # noqa: RUF012  (never changed)


def read_log(path: Path) -> Run:
    """Read a log.

    The log rounds steps ("step:1K"), so they are counted: line k is step k times `log_freq`.

    Raises:
        UserError: It is no such log, or does not start with the run's first step.
    """
    text = path.read_text(encoding="utf-8", errors="replace")
    frequency = re.search(r"'log_freq': (\d+)", text)
    lines = re.findall(r"\bstep:\S+ smpl:.*", text)
    if frequency is None or not lines:
        raise UserError(f"{path}: no lines of lerobot-train's log in it; keep the command's standard error in a file")
    steps = [int(frequency[1]) * count for count in range(1, len(lines) + 1)]
    _check_first(path, lines[0], steps[0])
    rows = [{key: float(value) for key, value in _NUMBER.findall(line)} for line in lines]
    there = [key for key in CURVES if any(key in row for row in rows)]
    values = {key: [row.get(key, math.nan) for row in rows] for key in there}
    return Run(path.stem, steps, values, _settings(text))


def _check_first(path: Path, line: str, step: int) -> None:
    from lerobot.utils.utils import format_big_number

    shown = line.split()[0].removeprefix("step:")
    if shown != format_big_number(step):
        raise UserError(
            f"{path}: starts at step {shown}, so it is of a resumed run: put the earlier log before it in one file"
        )


def _settings(text: str) -> dict[str, Any]:
    """From the configuration that the log starts with, printed as a Python dictionary."""
    patterns = {key: rf"'{key}': (\d+|'(?:{'|'.join(POLICIES)})')" for key in SETTINGS.values()}
    found = {name: re.search(patterns[key], text) for name, key in SETTINGS.items()}
    return {name: match[1].strip("'") for name, match in found.items() if match}


def labels(runs: Sequence[Run]) -> list[str]:
    """What to call each run: the settings that differ, or its file's name where those do not tell runs apart."""
    differing = [name for name in SETTINGS if len({str(run.settings.get(name)) for run in runs}) > 1]
    told = [", ".join(f"{name} {run.settings[name]}" for name in differing if name in run.settings) for run in runs]
    return [name if name and told.count(name) == 1 else run.name for run, name in zip(runs, told, strict=True)]
