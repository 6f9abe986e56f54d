"""LOReL's tabletop with a second task that can be done from the same start."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from lerobot_lisa.analysis.listening.two_goals import GOALS
from lerobot_lisa.envs.lorel.env import LorelEnv, Observation
from lerobot_lisa.envs.lorel.tasks import Bounds, Task


@dataclass(frozen=True)
class _FromBoth(Task):
    """A task whose episodes start so that others can be done as well, by the rule of the paper's compositions.

    Attributes:
        together: The parts of all of them.
    """

    together: tuple[str, ...] = ()

    @property
    def placement(self) -> Mapping[int, Bounds]:
        return Task("", self.together).placement

    @property
    def hand_target(self) -> tuple[float, float, float]:
        return Task("", self.together).hand_target


class SwappedLorel(LorelEnv):
    """A tabletop with two goals: that of a task, and that of another one, which the seed chooses.

    Which one is told is fixed; the episode ends with the goal that is told, or after the task's steps.

    Attributes:
        reached: Whether the goals `GOALS` have been reached in this episode.
    """

    def __init__(self, task: Task, others: Sequence[Task], told: str, **options: Any) -> None:
        """Note what to build; `told` is one of `GOALS`, `options` are those of `LorelEnv`."""
        super().__init__(task, **options)
        self._original, self._others, self._told = task, others, GOALS.index(told)
        self._goals = (task, task)
        self.reached = (False, False)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode; the same seed gives the same start and the same two tasks."""
        number = int(self.np_random.integers(len(self._others))) if seed is None else seed
        self._goals = (self._original, self._others[number % len(self._others)])
        told, together = self._goals[self._told], self._goals[0].parts + self._goals[1].parts
        self._task = _FromBoth(told.instruction, told.parts, told.kind, self._original.steps, together=together)
        self.task = self.task_description = told.instruction
        self.reached = (False, False)
        return super().reset(seed=seed, options=options)

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Act once, and look at both goals."""
        result = super().step(action)
        now = [goal.succeeded(self._first_state, self.state) for goal in self._goals]
        self.reached = (self.reached[0] or now[0], self.reached[1] or now[1])
        return result
