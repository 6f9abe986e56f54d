"""Meta-World's tasks by the names that LeRobot gives them, and the benchmarks that are lists of tasks."""

import json
from collections.abc import Mapping
from difflib import get_close_matches
from functools import cache
from importlib.resources import files
from typing import Any

from lerobot_lisa.errors import UserError

_BENCHMARKS = ("MT10", "MT25", "MT50")


def instructions() -> Mapping[str, str]:
    """What LeRobot's environment tells a policy in each task."""
    return _lerobots_tasks()["TASK_DESCRIPTIONS"]


def find_tasks(names: str) -> tuple[str, ...]:
    """The tasks that are meant, each once, in order.

    Args:
        names: Of benchmarks (`MT10`), of LeRobot's groups (`easy`) and of tasks (`reach-v3`), separated by commas.

    Raises:
        UserError: There is no such name, or none at all.
    """
    listed = [name.strip().removeprefix("metaworld-") for name in names.split(",") if name.strip()]
    if not listed:
        raise UserError(f"--tasks {names!r} names no task: give MT10, or names such as reach-v3, separated by commas")
    return tuple(dict.fromkeys(task for name in listed for task in _named(name)))


def _named(name: str) -> list[str]:
    groups = _lerobots_tasks()["DIFFICULTY_TO_TASKS"]
    if name in instructions():
        return [name]
    if name in groups:
        return groups[name]
    if name.upper() in _BENCHMARKS:
        return _benchmark(name.upper())
    near = get_close_matches(name, [*instructions(), *groups, *_BENCHMARKS], n=3)
    hint = f"did you mean {' or '.join(near)}?" if near else "`python -m dataset_converters.metaworld tasks` lists all"
    raise UserError(f"--tasks names {name!r}, which is no task of Meta-World: {hint}")


def _benchmark(name: str) -> list[str]:
    import lerobot_lisa.envs.engine  # noqa: F401  imports MuJoCo, as metaworld would, but chooses before how to draw

    from metaworld import env_dict  # isort: skip

    return list(getattr(env_dict, f"{name}_V3"))


@cache
def _lerobots_tasks() -> dict[str, Any]:
    """LeRobot's own table, read without the seconds that importing the simulator takes."""
    return json.loads((files("lerobot") / "envs" / "metaworld_config.json").read_text(encoding="utf-8"))
