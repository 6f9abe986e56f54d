"""Reads the log that `lerobot-train` writes to standard error."""

import re
from pathlib import Path
from typing import Any

from lerobot_lisa.analysis.runs.run import CURVES, SETTINGS, Run
from lerobot_lisa.errors import UserError

_NUMBER = re.compile(r"(\w+):(-?[\d.]+(?:e[-+]?\d+)?)(?= |$)")


def read_log(path: Path) -> Run:
    """Read a log.

    The log rounds steps ("step:1K"), so they are counted: line k is step k times `log_freq`.

    Raises:
        UserError: The file cannot be read, is no such log, or does not start with the run's first step.
    """
    try:
        text = path.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        raise UserError(f"{path}: {error.strerror or error}") from error
    frequency = re.search(r"'log_freq': (\d+)", text)
    lines = re.findall(r"\bstep:\S+ smpl:.*", text)
    if frequency is None or not lines:
        raise UserError(f"{path}: no lines of lerobot-train's log in it; keep the command's standard error in a file")
    steps = [int(frequency[1]) * count for count in range(1, len(lines) + 1)]
    _check_first(path, lines[0], steps[0])
    rows = [{key: float(value) for key, value in _NUMBER.findall(line)} for line in lines]
    values = {key: [row[key] for row in rows] for key in CURVES if all(key in row for row in rows)}
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
    patterns = {key: rf"'{key}': (\d+|'(?:lisa|lang_dt)')" for key in SETTINGS.values()}
    found = {name: re.search(patterns[key], text) for name, key in SETTINGS.items()}
    return {name: match[1].strip("'") for name, match in found.items() if match}
