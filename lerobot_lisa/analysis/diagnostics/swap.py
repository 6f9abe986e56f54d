"""Instruction swap: the same start, another instruction. Do skill code and actions change, is the new goal reached?"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from lerobot.envs.configs import EnvConfig
from numpy.typing import NDArray

from lerobot_lisa.analysis.diagnostics.worlds import GOALS, GoalWatcher, side_by_side
from lerobot_lisa.analysis.recording.evaluation import Evaluation, EvaluationConfig, load
from lerobot_lisa.analysis.recording.record import record
from lerobot_lisa.analysis.recording.traces import KEY
from lerobot_lisa.analysis.success.rates import success_rate
from lerobot_lisa.envs.babyai.config import BabyAIEnvConfig
from lerobot_lisa.envs.lorel.config import LorelEnvConfig
from lerobot_lisa.envs.lorel.groups import find_groups
from lerobot_lisa.errors import UserError

READING = (
    "Good: the first code changes about as often as it differs between episodes, each goal is reached far more often "
    "when it is told than when the other one is, and the other goal when told about as often as the original one."
)
Envs = dict[str, dict[int, Any]]


@dataclass(frozen=True)
class Arm:
    """The episodes that were told one of the two instructions.

    Attributes:
        steps: Their trace, columns of `traces.STEPS`.
        reached: Whether each has reached the goals `GOALS`, (E, 2).
    """

    steps: pd.DataFrame
    reached: NDArray[np.bool_]

    @property
    def first(self) -> pd.DataFrame:
        """The first step of each episode."""
        return self.steps.groupby(KEY, sort=False, observed=True).first()


def measure(config: EvaluationConfig) -> dict[str, Arm]:
    """Run every episode twice, told the original and the other instruction, with the same random numbers.

    Raises:
        UserError: The environment has no two goals, or the evaluation cannot work.
    """
    if not isinstance(config.env, BabyAIEnvConfig | LorelEnvConfig):
        raise UserError(f"--env.type={config.env.type}: instructions can be swapped in babyai and lorel")
    evaluation = load(config)
    return {told: _run(config, evaluation, told) for told in GOALS}


def _run(config: EvaluationConfig, evaluation: Evaluation, told: str) -> Arm:
    folder = config.output_dir / f"told_{told}"
    goals, envs = GoalWatcher(folder), _envs(config.env, told, config.batch_size)
    trace = record(config, folder, [goals], evaluation._replace(envs=envs), told=told)
    return Arm(trace.steps, goals.reached.loc[trace.episodes.set_index(KEY).index, list(GOALS)].to_numpy(bool))


def _envs(env: EnvConfig, told: str, count: int) -> Envs:
    if isinstance(env, LorelEnvConfig):
        from lerobot_lisa.analysis.diagnostics.swapped_lorel import SwappedLorel

        envs: Envs = {}
        for group, tasks in find_groups(env.task, env.arm).items():
            for task_id, task in enumerate(tasks):
                others = [other for other in tasks if set(other.parts).isdisjoint(task.parts)]
                if not others:
                    raise UserError(
                        f"--env.task={env.task}: {task.instruction!r} has no other task beside it: name a suite"
                    )
                make = partial(SwappedLorel, task, others, told, **env.gym_kwargs)
                envs.setdefault(group, {})[task_id] = side_by_side([make] * count)
        return envs
    from lerobot_lisa.analysis.diagnostics.swapped_babyai import SwappedBabyAI

    levels = [name.strip() for name in env.task.split(",")]
    make_all = [partial(SwappedBabyAI, level, told, **env.gym_kwargs) for level in levels]
    return {"babyai": {task_id: side_by_side([make] * count) for task_id, make in enumerate(make_all)}}


def table(arms: dict[str, Arm]) -> pd.DataFrame:
    """Which goal was reached under which instruction: columns `told`, `goal`, and those of `SuccessRate`."""
    rows = [
        {"told": told, "goal": goal, **vars(success_rate(arm.reached[:, number]))}
        for told, arm in arms.items()
        for number, goal in enumerate(GOALS)
    ]
    return pd.DataFrame(rows)


def lines(arms: dict[str, Arm]) -> Iterator[str]:
    """What changed at the first decision, and which goals were reached."""
    original, other = (arms[goal].first for goal in GOALS)
    if original["code"].notna().all():
        changed = (original["code"] != other["code"]).tolist()
        yield f"{success_rate(changed)}  first skill code changes with the instruction"
        shares = original["code"].value_counts(normalize=True)
        yield f"{'':>9}  {100 * (1 - (shares**2).sum()):5.1f} %  of pairs of different episodes differ in it"
    yield _first_actions(np.stack(original["action"]), np.stack(other["action"]))
    steps = common_steps(*(arms[goal].steps for goal in GOALS))
    yield f"{'':>9}  {np.median(steps):5.1f} steps are the same whatever is told, in half of the episodes (median)"
    for told, arm in arms.items():
        for goal, reached in zip(GOALS, arm.reached.T, strict=True):
            yield f"{success_rate(reached)}  of the {goal} goal when told the {told} one"


def common_steps(original: pd.DataFrame, other: pd.DataFrame) -> NDArray[np.int64]:
    """How many steps of each episode see and do the same in both runs, (E,)."""
    pairs = original.merge(other, on=[*KEY, "step"], suffixes=("", "_other"))
    seen = pairs["observation"] == pairs["observation_other"]
    done = [np.array_equal(a, b) for a, b in zip(pairs["action"], pairs["action_other"], strict=True)]
    same = seen & np.array(done, bool)
    return same.groupby([pairs[name] for name in KEY], observed=True).apply(lambda row: row.cummin().sum()).to_numpy()


def _first_actions(original: NDArray[np.float32], other: NDArray[np.float32]) -> str:
    """(E, A) each; categories are compared, real numbers measured in their own spread."""
    if original.shape[1] == 1 and not np.any(original % 1):
        return f"{success_rate((original != other).any(1).tolist())}  first action changes with the instruction"
    spread = np.abs(original[:, None] - original[None]).sum((0, 1)) / (len(original) * max(1, len(original) - 1))
    moved = np.abs(original - other).mean(0)
    ratio = float((moved[spread > 0] / spread[spread > 0]).mean()) if (spread > 0).any() else 0.0
    return f"{'':>9}  {100 * ratio:5.1f} %  as far apart are the first actions as those of two different episodes"
