"""Checks of options that environments share: each raises a `UserError` in one line."""

from collections.abc import Iterable
from math import inf

import numpy as np

from lerobot_lisa.errors import UserError


def names_in(task: object, what: str, option: str = "env.task") -> list[str]:
    """Names in `env.task`, or in another option, separated by commas.

    Raises:
        UserError: It is no text, or there is none.
    """
    names = [name.strip() for name in task.split(",") if name.strip()] if isinstance(task, str) else []
    if not names:
        raise UserError(f"{option} is {task!r}: name {what}, or several separated by commas")
    return names


def one_of(choices: Iterable[str], value: object, problem: str, hint: str = "") -> str:
    """Return `value`, one of the choices; else `problem` is the first half of the line."""
    listed = list(choices)
    if isinstance(value, str) and value in listed:
        return value
    raise UserError(f"{problem}: give one of {', '.join(listed)}{hint}")


def whole_number(value: object, low: int, high: float, problem: str) -> int:
    """Return `value`, a whole number from `low` to `high`; else `problem` is the first half of the line."""
    if isinstance(value, int | np.integer) and not isinstance(value, bool) and low <= value <= high:
        return int(value)
    raise UserError(f"{problem}: give a whole number from {low} {'up' if high == inf else f'to {high}'}")
