"""Success rates with their uncertainty, from the `eval_info.json` that `lerobot-eval` writes.

python -m lerobot_lisa.analysis.success outputs/eval/*/eval_info.json --json=success.json
python -m lerobot_lisa.analysis.success outputs/eval/lorel/eval_info.json --env.type=lorel

Several files, such as one for each training seed, are pooled. The file does not say which world it is of; told by
`--env.type`, random actions stand beside the numbers where that world knows what they achieve.
"""

import json
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd
from lerobot.envs.configs import EnvConfig

from lerobot_lisa.analysis.commands import run_command
from lerobot_lisa.analysis.success.rates import SuccessRate, known_tasks, rates
from lerobot_lisa.errors import UserError

OVERALL = "overall"


@dataclass
class SuccessConfig:
    """Which evaluations."""

    files: list[Path] = field(default_factory=list)
    """Files `eval_info.json`; may also stand before the first option."""

    env: EnvConfig | None = None
    """`--env.type` of the evaluation."""

    json: Path | None = None
    """Also write the numbers to this file."""

    def __post_init__(self) -> None:
        """Refuse nothing to do."""
        if not self.files:
            raise UserError("name one or several eval_info.json, before the first option")


def main() -> int:
    """Command line; returns the exit code."""
    return run_command(run, "files")


def run(config: SuccessConfig) -> None:
    """Print the rates of each file and of all of them together, and write them as JSON if asked to.

    Raises:
        UserError: See `read_episodes`.
    """
    world = config.env.type if config.env else None
    read = [read_episodes(path) for path in config.files]
    for path, episodes in zip(config.files, read, strict=True) if len(read) > 1 else ():
        print(_line(summarise(episodes, world).iloc[-1], str(path)))
    pooled = pd.concat(read, ignore_index=True)
    table = summarise(pooled, world)
    for row in table.to_dict("records"):
        print(_line(row, f"{row['part']}: {row['instruction']}" if row["instruction"] else row["part"]))
    if config.json:
        _write(config.json, config.files, table)


def read_episodes(path: Path) -> pd.DataFrame:
    """Every episode in an `eval_info.json`: columns `group`, `task_id`, `success`.

    Raises:
        UserError: The file cannot be read, is not what `lerobot-eval` writes, or holds no episode.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise UserError(f"{path}: not JSON ({error}): give the eval_info.json that lerobot-eval wrote") from error
    try:
        tasks = [(str(task["task_group"]), int(task["task_id"]), _successes(task)) for task in content["per_task"]]
    except (KeyError, TypeError, ValueError) as error:
        raise UserError(f"{path}: no successes per task in it: give the eval_info.json of lerobot-eval") from error
    if not tasks or not all(successes for *_, successes in tasks):
        raise UserError(f"{path}: a task without any episode in it: run lerobot-eval with --eval.n_episodes=100")
    rows = [(group, task_id, success) for group, task_id, successes in tasks for success in successes]
    return pd.DataFrame(rows, columns=["group", "task_id", "success"])


def _successes(task: dict[str, Any]) -> list[bool]:
    successes = task["metrics"]["successes"]
    if any(outcome not in (True, False) for outcome in successes):
        raise ValueError("an outcome is neither true nor false")
    return [bool(outcome) for outcome in successes]


def summarise(episodes: pd.DataFrame, world: str | None) -> pd.DataFrame:
    """Success rates of every task ("babyai/0"), every group ("babyai"), every suite of several groups, and "overall".

    Returns:
        In this order, the columns of `rates`, and `instruction`: of a task that the world knows, else "".
    """
    known = known_tasks(episodes, world)
    tasks = [f"{group}/{task_id}" for group, task_id in zip(episodes["group"], episodes["task_id"], strict=True)]
    suites = pd.Series([task.suite if task else None for task in known], episodes.index, dtype=object)
    parts = [tasks, episodes["group"], suites, [OVERALL] * len(episodes)]
    table = pd.concat([rates(episodes, part, world) for part in parts], ignore_index=True)
    told = {name: task.instruction for name, task in zip(tasks, known, strict=True) if task}
    return table.assign(instruction=table["part"].map(told).fillna(""))


def _line(row: Any, name: str) -> str:
    rate = SuccessRate(row["successes"], row["episodes"], row["percent"], row["low"], row["high"])
    beside = "" if pd.isna(row["random_actions"]) else f"  random actions {row['random_actions']:5.1f} %"
    return f"{rate}{beside}  {name}"


def _known(row: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in row.items() if not pd.isna(value) and value != ""}


def _write(path: Path, files: list[Path], table: pd.DataFrame) -> None:
    numbers = {row.pop("part"): _known(row) for row in table.to_dict("records")}
    path.parent.mkdir(parents=True, exist_ok=True)
    text = json.dumps({"files": [str(file) for file in files], "rates": numbers}, indent=2) + "\n"
    path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
