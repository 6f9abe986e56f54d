"""Which skill codes a person wants a rollout to follow, and when: the paper's manual planning and fixed skills."""

import re
from typing import NamedTuple

from lerobot_lisa.errors import UserError

PREDICTOR = "?"
_PART = re.compile(r"(\d{1,9}|\?)(?:\*(\d{1,9}))?")
_EXAMPLE = "write codes and steps as in '14*20,2*20', or '?' for the skill predictor's choice as in '?*10,14*10'"


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


def read_plan(text: str, codebook_size: int) -> SkillPlan:
    """Read a plan such as "14", "14*20,2*20" or "?*10,14*10,?".

    Args:
        text: Phases `CODE*STEPS` separated by commas; `CODE` is a number or `?`. The last one may leave out `*STEPS`
            and then lasts to the end of the episode.
        codebook_size: K; codes are below it.

    Raises:
        UserError: It is no plan, or there is no such code.
    """
    parts = [part.strip() for part in text.split(",")]
    text = text if len(text) <= 80 else f"{text[:80]}..."  # in messages
    phases = tuple(_read_phase(part, text, codebook_size) for part in parts)
    if endless := next((part for part, phase in zip(parts[:-1], phases, strict=False) if phase.steps is None), None):
        raise UserError(f"skill plan {text!r}: nothing can follow {endless!r}, which has no end: {_EXAMPLE}")
    return SkillPlan(phases)


def _read_phase(part: str, text: str, codebook_size: int) -> Phase:
    found = _PART.fullmatch(part)
    if not found or (found[2] and int(found[2]) == 0):
        raise UserError(f"skill plan {text!r}: {part[:20]!r} is no part of a plan: {_EXAMPLE}")
    code = None if found[1] == PREDICTOR else int(found[1])
    if code is not None and code >= codebook_size:
        raise UserError(
            f"skill plan {text!r}: there is no skill code {code}; this policy has codes 0 to {codebook_size - 1}"
        )
    return Phase(code, int(found[2]) if found[2] else None)
