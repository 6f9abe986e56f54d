"""What every skill code does to every task when the whole episode follows it (paper, "Behavior with fixed skills")."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from tqdm import tqdm

from lerobot_lisa.analysis.drawing import LABELLED, MOST_CODES, Grid, Plot, clip, heat_map, styled
from lerobot_lisa.analysis.recording.evaluation import EvaluationConfig, load, steered
from lerobot_lisa.analysis.recording.record import record
from lerobot_lisa.analysis.recording.traces import Trace
from lerobot_lisa.analysis.skills.choices import choices
from lerobot_lisa.analysis.success.breakdown import by_task, task_names

OWN, RANDOM = "own", "rand."
_TITLE = "Success of every task under every skill code"
_STARTS_TITLE = "Success of every start under every skill code"
READING = (
    "Each row is a task, each numbered column the success rate with that one code for whole episodes; `own` is the "
    "policy's own choice of codes, `rand.` random actions where known. Good: every task has a code that alone does it "
    "about as well as `own`, and a different one than the other tasks. The best of many codes is chosen after the "
    "fact and so looks better than it is: confirm it with another --seed."
)

STARTS_READING = (
    "Each row is a start: a task and the seed of its episode, the same for every column; dark where the episode "
    "succeeded. Good: the code of a task is dark in all of its rows, wherever the episode starts, and in none of "
    "another task's. A code that is dark here and there does something else, which sometimes is enough."
)


class Matrix(NamedTuple):
    """What every skill code does.

    Attributes:
        tasks: Success rates: columns `task`, `code` ("own", and the codes' labels: "0", "1", ...), those of
            `success.rates`, and `left_out`, the number of codes that were not tried.
        starts: Single episodes: columns `task`, `seed`, `code` and `success`.
    """

    tasks: pd.DataFrame
    starts: pd.DataFrame


def measure(config: EvaluationConfig) -> Matrix:
    """Success rates of every task with the policy's own codes and with each code alone.

    Every code's evaluation is a trace of its own in `config.output_dir`, so that an interrupted matrix goes on. Of a
    codebook of more than `MOST_CODES` only those are tried that the policy itself chose, the most frequent first.

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
    named = ((label, run(str(code))) for code, label in tqdm(tried, unit="code", disable=None))
    traces = {OWN: own, **dict(named)}
    rates = [by_task(trace).assign(code=code) for code, trace in traces.items()]
    table = pd.concat(rates, ignore_index=True).rename(columns={"part": "task"})
    starts = [_starts(trace).assign(code=code) for code, trace in traces.items()]
    return Matrix(table.assign(left_out=made.size - len(tried)), pd.concat(starts, ignore_index=True))


def _starts(trace: Trace) -> pd.DataFrame:
    names, episodes = task_names(trace), trace.episodes
    tasks = [names[task] for task in zip(episodes["group"], episodes["task_id"], strict=True)]
    return pd.DataFrame({"task": tasks, "seed": episodes["seed"], "success": episodes["success"]})


def starts_plot(table: pd.DataFrame, sample: str) -> Plot:
    """Single episodes as a heat map, the first `LABELLED` starts.

    Args:
        table: `Matrix.starts`.
        sample: What was counted, for the title.
    """
    order = pd.MultiIndex.from_frame(table[["task", "seed"]].drop_duplicates())
    done = table.pivot(index=["task", "seed"], columns="code", values="success").astype(np.float64)
    done = done.loc[order, table["code"].unique()]
    rows = [f"{clip(str(task))}, seed {seed}" for task, seed in order]
    grid = Grid(done.to_numpy()[:LABELLED], rows[:LABELLED], list(done.columns),
                ("start", "one skill code for the whole episode"), "success")  # fmt: skip
    with styled():
        figure = heat_map(grid, _STARTS_TITLE, sample, highest=1)
    more = f" The first {LABELLED} of {len(rows):,} starts; the CSV has all." if len(rows) > LABELLED else ""
    return Plot("skill_starts", _STARTS_TITLE, figure, table, STARTS_READING + more)


def matrix_plot(table: pd.DataFrame, sample: str) -> Plot:
    """The matrix as a heat map.

    Args:
        table: `Matrix.tasks`.
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
