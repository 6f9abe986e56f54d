"""Tells a policy something else than the world asks for, in any environment of LeRobot's."""

from collections.abc import Mapping
from typing import Any

from lerobot_lisa.analysis.recording.environment import TASK_NAMES
from lerobot_lisa.analysis.recording.evaluation import Evaluation

Told = Mapping[tuple[str, int], Mapping[int, str]]
"""What to tell, by (group, task id), then by the episode's seed."""


class TellingEnv:
    """A vectorised environment that gives another instruction away than its own; otherwise it is the one it wraps.

    Its worlds know nothing of it: they start, and judge success, by their own instruction.
    """

    def __init__(self, env: Any, told: Mapping[int, str]) -> None:
        """Wrap what LeRobot would evaluate in; `told` has the instruction by seed, where there is another one."""
        self._env, self._told = env, told
        self._now: list[str | None] = [None] * env.num_envs

    def __getattr__(self, name: str) -> Any:
        """Everything else is the wrapped environment's."""
        return getattr(self._env, name)

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start episodes of these seeds, one for each environment."""
        self._now = [self._told.get(number) for number in seed]
        return self._env.reset(seed=seed, options=options)

    def call(self, name: str, *args: Any, **kwargs: Any) -> Any:
        """Ask every environment, and answer in its place when it is asked for the instruction."""
        answers = self._env.call(name, *args, **kwargs)
        if name not in TASK_NAMES:
            return answers
        return tuple(own if told is None else told for own, told in zip(answers, self._now, strict=True))


def telling(evaluation: Evaluation, told: Told) -> Evaluation:
    """The evaluation with other instructions."""
    envs = {
        group: {task_id: TellingEnv(env, told.get((group, task_id), {})) for task_id, env in tasks.items()}
        for group, tasks in evaluation.envs.items()
    }
    return evaluation._replace(envs=envs)
