"""The paper's affordance test: is a task's skill code chosen because it is asked for, or because it could be done?

Every episode starts where the task can be done (the drawer stands open, say); only the words differ.
"""

from collections.abc import Iterator
from functools import partial

import pandas as pd

from lerobot_lisa.analysis.listening.meanings import instructions_about
from lerobot_lisa.analysis.recording.evaluation import EvaluationConfig, lisa_config, load
from lerobot_lisa.analysis.recording.record import record
from lerobot_lisa.analysis.recording.traces import Trace
from lerobot_lisa.analysis.success.rates import success_rate
from lerobot_lisa.envs.lorel.config import LorelEnvConfig
from lerobot_lisa.envs.lorel.tasks import Task
from lerobot_lisa.envs.vector import InTurn
from lerobot_lisa.errors import UserError

READING = (
    "Good: the code is chosen in (nearly) every episode whose instruction means the task and in none of the others, "
    "which differ in a word only; that the scene is the same shows that words choose it and not what could be done. "
    "The paper found 20 of 20 for three of its four ways to say `close drawer`, and 0 of 20 for the twelve others."
)
_GROUP = "affordance"


def measure(config: EvaluationConfig) -> Trace:
    """Run every instruction about `--env.task` from the task's own starts, the same seeds for each.

    Raises:
        UserError: The environment or its task is none of LOReL's, or the policy has no skill codes.
    """
    if not isinstance(config.env, LorelEnvConfig):
        raise UserError(f"--env.type={config.env.type}: the affordance test knows the tasks of lorel")
    lisa_config(config)
    instructions = instructions_about(config.env.task)
    from lerobot_lisa.envs.lorel.env import LorelEnv

    tasks = [Task(text, (config.env.task,), kind) for kind, listed in instructions.items() for text in listed]
    make = [partial(LorelEnv, task, **config.env.gym_kwargs) for task in tasks]
    evaluation = load(config)
    envs = {_GROUP: {number: InTurn([one] * config.batch_size) for number, one in enumerate(make)}}
    return record(config, config.output_dir, evaluation=evaluation._replace(envs=envs), instructions=instructions)


def own_code(trace: Trace) -> int:
    """The code that the task's own instruction, the first one, gets most often at the first decision."""
    own = trace.steps[(trace.steps["task_id"] == 0) & (trace.steps["step"] == 0)]
    return int(own["code"].mode().iloc[0])


def table(trace: Trace, code: int) -> pd.DataFrame:
    """A row for each instruction: in how many episodes the code was chosen first, or at all, and the task was done.

    `unknown` lists words that a word-level policy has not learned: to it they are all the same one.
    """
    vocabulary = trace.origin["policy"].get("vocabulary")
    kinds = {text: kind for kind, listed in trace.origin["instructions"].items() for text in listed}
    rows = []
    for task_id, steps in trace.steps.groupby("task_id", sort=True):
        chosen = (steps["code"] == code).groupby(steps["episode"])
        done = trace.episodes.loc[trace.episodes["task_id"] == task_id, "success"]
        text = str(steps["instruction"].iloc[0])
        counts = {"first": int(chosen.first().sum()), "ever": int(chosen.any().sum()), "success": int(done.sum())}
        unknown = " ".join(word for word in text.split() if vocabulary and word not in vocabulary)
        rows.append({"shares": kinds[text], "instruction": text, "unknown": unknown, "episodes": len(done), **counts})
    return pd.DataFrame(rows)


def lines(trace: Trace) -> Iterator[str]:
    """The code, its choice by instruction, and by what the instructions share with the task."""
    code = own_code(trace)
    rows = table(trace, code)
    yield f"skill code {code} is what {rows['instruction'].iloc[0]!r} gets most often at the first decision"
    for row in rows.itertuples():
        counts = (
            f"first {row.first}/{row.episodes}, ever {row.ever}/{row.episodes}, task done {row.success}/{row.episodes}"
        )
        yield f"  {row.instruction:<24} {counts}  ({row.shares})"
    for kind, part in rows.groupby("shares", sort=False):
        n = int(part["episodes"].sum())
        yield f"{_share(int(part['first'].sum()), n)}  chosen first: {kind}"


def _share(count: int, n: int) -> str:
    return str(success_rate([True] * count + [False] * (n - count)))
