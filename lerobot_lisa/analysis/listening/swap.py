"""Instruction swap: the same start, another instruction. Do skill code and actions change, is the new goal reached?"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from lerobot.envs.configs import EnvConfig
from numpy.typing import NDArray

from lerobot_lisa.analysis.listening import reactions
from lerobot_lisa.analysis.listening.two_goals import GOALS, GoalWatcher
from lerobot_lisa.analysis.recording.evaluation import Evaluation, EvaluationConfig, load
from lerobot_lisa.analysis.recording.record import record
from lerobot_lisa.analysis.recording.traces import KEY
from lerobot_lisa.analysis.success.rates import success_rate
from lerobot_lisa.envs.babyai.config import BabyAIEnvConfig
from lerobot_lisa.envs.lorel.config import LorelEnvConfig
from lerobot_lisa.envs.lorel.groups import find_groups
from lerobot_lisa.envs.vector import InTurn
from lerobot_lisa.errors import UserError

READING = (
    "Good: the first code changes about as often as it differs between episodes, each goal is reached far more often "
    "when it is told than when the other one is, and the other goal when told about as often as the original one."
)
Envs = dict[str, dict[int, Any]]


@dataclass(frozen=True)
class ToldRun:
    """The episodes, told one of the two instructions.

    Attributes:
        steps: Their trace, columns of `traces.STEPS`.
        reached: Whether each has reached the goals `GOALS`, (E, 2).
    """

    steps: pd.DataFrame
    reached: NDArray[np.bool_]


def measure(config: EvaluationConfig) -> dict[str, ToldRun]:
    """Run every episode twice, told the original and the other instruction, with the same random numbers.

    Raises:
        UserError: The environment has no two goals, or the evaluation cannot work.
    """
    if not isinstance(config.env, BabyAIEnvConfig | LorelEnvConfig):
        raise UserError(f"--env.type={config.env.type}: instructions can be swapped in babyai and lorel")
    evaluation = load(config)
    return {told: _run(config, evaluation, told) for told in GOALS}


def _run(config: EvaluationConfig, evaluation: Evaluation, told: str) -> ToldRun:
    folder = config.output_dir / f"told_{told}"
    goals, envs = GoalWatcher(folder), _envs(config.env, told, config.batch_size)
    trace = record(config, folder, [goals], evaluation._replace(envs=envs), told=told)
    return ToldRun(trace.steps, goals.reached.loc[trace.episodes.set_index(KEY).index, list(GOALS)].to_numpy(bool))


def _envs(env: EnvConfig, told: str, count: int) -> Envs:
    if isinstance(env, LorelEnvConfig):
        from lerobot_lisa.analysis.listening.swapped_lorel import SwappedLorel

        envs: Envs = {}
        for group, tasks in find_groups(env.task, env.arm).items():
            for task_id, task in enumerate(tasks):
                others = [other for other in tasks if set(other.parts).isdisjoint(task.parts)]
                if not others:
                    raise UserError(
                        f"--env.task={env.task}: {task.instruction!r} has no other task beside it: name a suite"
                    )
                make = partial(SwappedLorel, task, others, told, **env.gym_kwargs)
                envs.setdefault(group, {})[task_id] = InTurn([make] * count)
        return envs
    from lerobot_lisa.analysis.listening.swapped_babyai import SwappedBabyAI

    make_all = [partial(SwappedBabyAI, level, told, **env.gym_kwargs) for level in env.levels]
    return {"babyai": {task_id: InTurn([make] * count) for task_id, make in enumerate(make_all)}}


def table(runs: dict[str, ToldRun]) -> pd.DataFrame:
    """Which goal was reached under which instruction: columns `told`, `goal`, and those of `SuccessRate`."""
    rows = [
        {"told": told, "goal": goal, **vars(success_rate(run.reached[:, number]))}
        for told, run in runs.items()
        for number, goal in enumerate(GOALS)
    ]
    return pd.DataFrame(rows)


def lines(runs: dict[str, ToldRun]) -> Iterator[str]:
    """What changed at the first decision, and which goals were reached."""
    yield from reactions.lines(*(runs[goal].steps for goal in GOALS))
    for told, run in runs.items():
        for goal, reached in zip(GOALS, run.reached.T, strict=True):
            yield f"{success_rate(reached)}  of the {goal} goal when told the {told} one"
