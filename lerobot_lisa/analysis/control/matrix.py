"""What every skill code does to every task when the whole episode follows it (paper, "Behavior with fixed skills")."""

from collections.abc import Iterator

import numpy as np
import pandas as pd
from tqdm import tqdm

from lerobot_lisa.analysis.control.steering import lisa_config, steered
from lerobot_lisa.analysis.figures.heat_map import heat_map
from lerobot_lisa.analysis.figures.plot import Plot
from lerobot_lisa.analysis.figures.style import styled
from lerobot_lisa.analysis.recording.evaluation import EvaluationConfig, load
from lerobot_lisa.analysis.recording.record import record
from lerobot_lisa.analysis.statistics.breakdown import by_task

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

    Every code's evaluation is a trace of its own in `config.output_dir`, so that an interrupted matrix goes on.

    Returns:
        Columns `task`, `code` ("own", "0", "1", ...) and those of `breakdown.rates`.

    Raises:
        UserError: The policy has no skill codes, or the evaluation cannot work.
    """
    from lerobot.envs import make_env

    evaluation = load(steered(config, None))
    tables = []
    for code in tqdm([OWN, *map(str, range(lisa_config(config).codebook_size))], unit="code", disable=None):
        plan = None if code == OWN else code
        evaluation.policy.follow(plan)
        envs = make_env(config.env, n_envs=config.batch_size, use_async_envs=config.use_async_envs)
        again = evaluation._replace(envs=envs)
        trace = record(steered(config, plan), config.output_dir / f"skill_{code}", evaluation=again)
        tables.append(by_task(trace).rename(columns={"part": "task"}).assign(code=code))
    return pd.concat(tables, ignore_index=True)


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
    with styled():
        figure = heat_map(
            percent.to_numpy(np.float64),
            list(percent.index),
            list(percent.columns),
            ("task", "one skill code for the whole episode"),
            "success (%)",
            _TITLE,
            sample,
            highest=100,
        )
    return Plot("skill_matrix", _TITLE, figure, table, READING)


def lines(table: pd.DataFrame) -> Iterator[str]:
    """For each task its best code beside the policy's own choice and random actions."""
    for task, rows in table.groupby("task", sort=False):
        own, alone = rows[rows["code"] == OWN].iloc[0], rows[rows["code"] != OWN]
        best = alone.loc[alone["percent"].idxmax()]
        beside = "" if np.isnan(own["random_actions"]) else f", random actions {own['random_actions']:.1f} %"
        yield f"{task}: best alone is code {best['code']}, {_rate(best)}; own codes {_rate(own)}{beside}"


def _rate(row: pd.Series) -> str:
    return f"{row['percent']:.1f} % ({row['low']:.1f} to {row['high']:.1f}, n = {row['episodes']})"
