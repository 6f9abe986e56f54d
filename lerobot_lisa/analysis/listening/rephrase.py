"""Rephrasing robustness: success and skill codes of LOReL's 77 instructions by how their words differ from training."""

from collections.abc import Iterator
from copy import copy
from dataclasses import replace

import pandas as pd

from lerobot_lisa.analysis.recording.evaluation import EvaluationConfig
from lerobot_lisa.analysis.recording.record import record
from lerobot_lisa.analysis.recording.traces import Trace
from lerobot_lisa.analysis.success.rates import SuccessRate, rates, success_rate
from lerobot_lisa.envs.lorel.config import LorelEnvConfig
from lerobot_lisa.envs.lorel.groups import tasks_of
from lerobot_lisa.envs.lorel.tasks import Task
from lerobot_lisa.errors import UserError

READING = (
    "Good: every kind of wording reaches about the success of the seen one, well above random actions, and gets the "
    "code of the seen wording far more often than another task's instruction does."
)
_SEEN, _OTHER_TASK = "seen", "another task, seen wording"


def measure(config: EvaluationConfig) -> Trace:
    """Evaluate the suite of rephrasals.

    Raises:
        UserError: The environment is not LOReL's, or the evaluation cannot work.
    """
    if not isinstance(config.env, LorelEnvConfig):
        raise UserError(f"--env.type={config.env.type}: the rephrasals are lorel's")
    everything = copy(config)
    everything.env = replace(config.env, task="rephrasals")
    return record(everything, config.output_dir / "rephrase")


def table(trace: Trace) -> pd.DataFrame:
    """A row for each kind of instruction.

    Returns:
        Columns of `breakdown.rates`, and `same_code`, `same_code_low`, `same_code_high`: how often, in percent, the
        first skill code is that of the seen wording in the same episode; nan for a policy without codes. The last row
        is about the seen wordings of other tasks: what agreement there is anyway.
    """
    kinds = [task.kind for task in _tasks(trace.episodes)]
    success = rates(trace.episodes, kinds, trace.world)
    if not trace.has_codes:
        return success.assign(same_code=float("nan"), same_code_low=float("nan"), same_code_high=float("nan"))
    agreement = {kind: success_rate(agreed) for kind, agreed in _agreement(trace).items()}
    success = pd.concat([success, pd.DataFrame({"part": [_OTHER_TASK]})], ignore_index=True)
    return success.assign(
        same_code=[agreement[part].percent for part in success["part"]],
        same_code_low=[agreement[part].low for part in success["part"]],
        same_code_high=[agreement[part].high for part in success["part"]],
    )


def _tasks(rows: pd.DataFrame) -> list[Task]:
    return [tasks_of(group)[task_id] for group, task_id in zip(rows["group"], rows["task_id"], strict=True)]


def _agreement(trace: Trace) -> dict[str, list[bool]]:
    """By row of the table, whether first codes are those of a seen wording with the same seed."""
    first = trace.steps[trace.steps["step"] == 0]
    tasks = _tasks(first)
    first = first.assign(kind=[task.kind for task in tasks], means=[task.parts[0] for task in tasks])
    seen = first.loc[first["kind"] == _SEEN, ["seed", "means", "code"]]
    pairs = first.merge(seen, on="seed", suffixes=("", "_seen"))
    same_task = pairs["means"] == pairs["means_seen"]
    pairs["row"] = pairs["kind"].where(same_task, _OTHER_TASK)
    pairs = pairs[same_task | (pairs["kind"] == _SEEN)]
    return {str(row): list(part["code"] == part["code_seen"]) for row, part in pairs.groupby("row")}


def lines(trace: Trace) -> Iterator[str]:
    """The table for people."""
    for row in table(trace).itertuples():
        rate = SuccessRate(row.successes, row.episodes, row.percent, row.low, row.high)
        success = f"{rate}  random {row.random_actions:4.1f} %" if row.part != _OTHER_TASK else " " * 65
        codes = "" if row.same_code != row.same_code else f"  same code {row.same_code:5.1f} %"
        yield f"{success}{codes}  {row.part}"
