"""What every skill code does to every task when the whole episode follows it (paper, "Behavior with fixed skills")."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd
from tqdm import tqdm

from lerobot_lisa.analysis.drawing import MOST_CODES, Grid, Plot, heat_map, styled
from lerobot_lisa.analysis.recording.evaluation import EvaluationConfig, load, steered
from lerobot_lisa.analysis.recording.record import record
from lerobot_lisa.analysis.recording.traces import Trace
from lerobot_lisa.analysis.skills.choices import choices
from lerobot_lisa.analysis.success.breakdown import by_task

OWN, RANDOM = "own", "rand."
_TITLE = "Success of every task under every skill code"
READING = (
    "Each row is a task, each numbered column the success rate with that one code for whole episodes; `own` is the "
    "policy's own choice of codes, `rand.` random actions where known. Good: every task has a code that alone does it "
    "about as well as `own`, and a different one than the other tasks. The best of many codes is chosen after the "
    "fact and so looks better than it is: confirm it with another --seed."
)


def measure(config: EvaluationConfig) -> pd.DataFrame:
    """Success rates of every task with the policy's own codes and with each code alone.

    Every code's evaluation is a trace of its own in `config.output_dir`, so that an interrupted matrix goes on. Of a
    codebook of more than `MOST_CODES` only those are tried that the policy itself chose, the most frequent first.

    Returns:
        Columns `task`, `code` ("own", and the codes' labels: "0", "1", ...), those of `success.rates`, and `left_out`,
        the number of codes that were not tried.

    Raises:
        UserError: The policy has no skill codes, or the evaluation cannot work.
    """
    from lerobot.envs import make_env

    evaluation = load(steered(config, None))

    def run(plan: str | None) -> Trace:
        evaluation.policy.follow(plan)
        envs = make_env(config.env, n_envs=config.batch_size, use_async_envs=config.use_async_envs)
        again, folder = evaluation._replace(envs=envs), config.output_dir / f"skill_{plan or OWN}"
        return record(steered(config, plan), folder, evaluation=again)

    own = run(None)
    made = choices(own)
    tried = list(zip(made.codes, made.labels, strict=True))[:MOST_CODES]
    tables = [by_task(own).assign(code=OWN)]
    for code, label in tqdm(tried, unit="code", disable=None):
        tables.append(by_task(run(str(code))).assign(code=label))
    table = pd.concat(tables, ignore_index=True).rename(columns={"part": "task"})
    return table.assign(left_out=made.size - len(tried))


def matrix_plot(table: pd.DataFrame, sample: str) -> Plot:
    """The matrix as a heat map.

    Args:
        table: From `measure`.
        sample: What was counted, for the title.
    """
    percent = table.pivot(index="task", columns="code", values="percent")
    percent = percent.loc[table["task"].unique(), table["code"].unique()]
    floor = table.drop_duplicates("task").set_index("task")["random_actions"]
    if floor.notna().any():
        percent.insert(1, RANDOM, floor)
    axes = ("task", "one skill code for the whole episode")
    grid = Grid(percent.to_numpy(np.float64), list(percent.index), list(percent.columns), axes, "success (%)")
    with styled():
        figure = heat_map(grid, _TITLE, sample, highest=100)
    missing = int(table["left_out"].iloc[0]) if "left_out" in table else 0
    note = f" Left out: {missing:,} codes that the policy itself chose rarely or never." if missing else ""
    return Plot("skill_matrix", _TITLE, figure, table, READING + note)


def said(table: pd.DataFrame) -> Iterator[str]:
    """For each task a line: its best code beside the policy's own choice and random actions."""
    for task, rows in table.groupby("task", sort=False):
        own, alone = rows[rows["code"] == OWN].iloc[0], rows[rows["code"] != OWN]
        best = alone.loc[alone["percent"].idxmax()]
        beside = "" if np.isnan(own["random_actions"]) else f", random actions {own['random_actions']:.1f} %"
        yield f"{task}: best alone is code {best['code']}, {_rate(best)}; own codes {_rate(own)}{beside}"


def _rate(row: Any) -> str:
    return f"{row['percent']:.1f} % ({row['low']:.1f} to {row['high']:.1f}, n = {row['episodes']})"
