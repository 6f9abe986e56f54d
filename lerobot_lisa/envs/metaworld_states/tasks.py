"""Meta-World's tasks by the names that LeRobot gives them, and the benchmarks that are lists of tasks."""

import json
from collections.abc import Mapping
from difflib import get_close_matches
from functools import cache
from importlib.resources import files
from typing import Any

from lerobot_lisa.envs.options import names_in
from lerobot_lisa.errors import UserError

_BENCHMARKS = ("MT10", "MT25", "MT50")


def instructions() -> Mapping[str, str]:
    """What LeRobot's environment tells a policy in each task."""
    return _lerobots_tasks()["TASK_DESCRIPTIONS"]


def find_groups(names: str, option: str = "env.task") -> dict[str, list[str]]:
    """The tasks that are meant, by what names them, in order.

    Args:
        names: Of benchmarks (`MT10`), of LeRobot's groups (`easy`) and of tasks (`reach-v3`), separated by commas.
        option: Where they were given.

    Raises:
        UserError: There is no such name, or none at all.
    """
    return {name: tasks_of(name) for name in names_in(names, "MT10, or tasks such as reach-v3", option)}


def find_tasks(names: str, option: str = "env.task") -> tuple[str, ...]:
    """The same tasks, each once, in order."""
    return tuple(dict.fromkeys(task for tasks in find_groups(names, option).values() for task in tasks))


def tasks_of(name: str) -> list[str]:
    """The tasks of a benchmark or group, in order; a task is its own group.

    Raises:
        UserError: There is no such name.
    """
    groups, task = _lerobots_tasks()["DIFFICULTY_TO_TASKS"], name.removeprefix("metaworld-")
    if task in instructions():
        return [task]
    if name in groups:
        return groups[name]
    if name.upper() in _BENCHMARKS:
        return _benchmark(name.upper())
    near = get_close_matches(name, [*instructions(), *groups, *_BENCHMARKS], n=3)
    hint = f"did you mean {' or '.join(near)}?" if near else "`python -m dataset_converters.metaworld tasks` lists all"
    raise UserError(f"{name!r} is no task of Meta-World: {hint}")


def _benchmark(name: str) -> list[str]:
    import lerobot_lisa.envs.engine  # noqa: F401  imports MuJoCo, as metaworld would, but chooses before how to draw

    from metaworld import env_dict  # isort: skip

    return list(getattr(env_dict, f"{name}_V3"))


@cache
def _lerobots_tasks() -> dict[str, Any]:
    """LeRobot's own table, read without the seconds that importing the simulator takes."""
    return json.loads((files("lerobot") / "envs" / "metaworld_config.json").read_text(encoding="utf-8"))
