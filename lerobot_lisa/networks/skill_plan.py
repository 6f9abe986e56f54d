"""Which skill codes a person wants a rollout to follow, and when: the paper's manual planning and fixed skills."""

import re
from collections.abc import Callable
from typing import NamedTuple

from lerobot_lisa.errors import UserError

PREDICTOR = "?"
_PART = re.compile(r"([^*,]+?)\s*(?:\*\s*(\d{1,9}))?")
_EXAMPLE = (
    "write codes and steps as in '14*20,2*20', names of codes as in 'red ball*20', "
    "or '?' for the skill predictor's choice as in '?*10,14*10'"
)


class Phase(NamedTuple):
    """A part of a plan.

    Attributes:
        code: Skill code; None: what the skill predictor chooses.
        steps: How long; None: to the end of the episode.
    """

    code: int | None
    steps: int | None


class SkillPlan(NamedTuple):
    """Phases, one after the other from an episode's first step; after the last one the skill predictor chooses.

    A plan counts steps, whatever the horizon H is: a phase begins a new chunk of the policy, at any step, and so does
    every H-th step after it. So "14*25" at a horizon of 10 is two chunks of 10 steps with code 14 and one of 5. A
    phase that is left to the skill predictor is asked for at its first step and every H steps from there; if that is
    no multiple of H, the predictor is asked at steps of an episode where it never was in training.
    """

    phases: tuple[Phase, ...] = ()

    def at(self, step: int) -> tuple[int | None, int]:
        """The code at a step of the episode, None if the skill predictor chooses, and steps since its phase began."""
        for code, steps in self.phases:
            if steps is None or step < steps:
                return code, step
            step -= steps
        return None, step


def read_plan(text: str, find_code: Callable[[str], int]) -> SkillPlan:
    """Read a plan such as "14", "14*20,2*20", "red ball*20" or "?*10,14*10,?".

    Args:
        text: Phases `CODE*STEPS` separated by commas; `CODE` is a number, a name or `?`. The last one may leave out
            `*STEPS` and then lasts to the end of the episode.
        find_code: The code that a number or name means; raises `UserError` if there is none.

    Raises:
        UserError: It is no plan, or there is no such code.
    """
    shown = text if len(text) <= 80 else f"{text[:77]}..."
    parts = [part.strip() for part in text.split(",")]
    phases = tuple(_read_phase(part, shown, find_code) for part in parts)
    if endless := next((part for part, phase in zip(parts[:-1], phases, strict=False) if phase.steps is None), None):
        raise UserError(f"skill plan {shown!r}: nothing can follow {endless!r}, which has no end: {_EXAMPLE}")
    return SkillPlan(phases)


def _read_phase(part: str, text: str, find_code: Callable[[str], int]) -> Phase:
    found = _PART.fullmatch(part)
    if not found or (found[2] and int(found[2]) == 0):
        raise UserError(f"skill plan {text!r}: {part[:80]!r} is no part of a plan: {_EXAMPLE}")
    try:
        code = None if found[1] == PREDICTOR else find_code(found[1])
    except UserError as error:
        raise UserError(f"skill plan {text!r}: {error}") from error
    return Phase(code, int(found[2]) if found[2] else None)
