"""BabyAI worlds with a second instruction that can be carried out in them, too."""

from typing import Any

import numpy as np

from lerobot_lisa.analysis.listening.babyai import TRIES, another_instruction
from lerobot_lisa.analysis.listening.two_goals import GOALS
from lerobot_lisa.envs.babyai.env import BabyAIEnv, Observation
from lerobot_lisa.envs.babyai.levels import make_level
from lerobot_lisa.errors import UserError

_SEEDS = 1_000_000  # seeds of training begin there


class SwappedBabyAI(BabyAIEnv):
    """A level whose worlds have two goals: the world's own instruction and that of another episode of the level.

    The other one is drawn until its objects are in this world, too, so that it could have been this world's
    instruction. Which one is told is fixed; the episode ends with the goal that is told. The step limit is the longer
    one of the two.

    Attributes:
        reached: Whether the goals `GOALS` have been reached in this episode.
    """

    def __init__(self, task: str, told: str, **options: Any) -> None:
        """Build the level; `told` is one of `GOALS`, `options` are those of `BabyAIEnv`."""
        super().__init__(task, **options)
        self._told = GOALS.index(told)
        self._source = make_level(task)
        self.reached = (False, False)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode; the same seed gives the same world and the same two instructions."""
        super().reset(seed=seed, options=options)
        level = self._level
        instructions = (level.instrs, self._another(int(self.np_random.integers(_SEEDS)) if seed is None else seed))
        level.instrs, self._watched = instructions[self._told], instructions[1 - self._told]
        level.mission = self.task_description = level.instrs.surface(level)
        self._watched.reset_verifier(level)
        level.instrs.reset_verifier(level)
        if not level.fixed_max_steps:
            level.max_steps = max(level.max_steps, self._source.max_steps)
        self.reached = (False, False)
        return self._observation(), {"is_success": False}

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Act once, and look whether the goal that is not told has been reached by the way."""
        observation, reward, terminated, truncated, info = super().step(action)
        level, number = self._level, round(float(np.asarray(action).reshape(-1)[0]))
        if number == level.actions.drop:
            level.update_objs_poss(self._watched)
        untold = self._watched.verify(number) == "success"
        now = (untold, info["is_success"]) if self._told else (info["is_success"], untold)
        self.reached = (self.reached[0] or now[0], self.reached[1] or now[1])
        return observation, reward, terminated, truncated, info

    def _another(self, seed: int) -> Any:
        """The instruction of another episode that says something else and can be carried out here."""
        instruction = another_instruction(self._level, self._source, seed)
        if instruction is None:
            raise UserError(
                f"{self.task}: none of {TRIES} other instructions can be carried out in the world of seed {seed}"
            )
        return instruction
