"""Suites as LeRobot's task groups: `eval_info.json` knows a task by the name of its group and its place in it."""

import re
from collections.abc import Iterator
from types import MappingProxyType

from lerobot_lisa.envs.lorel.suites import KINDS, SUITES, find_task
from lerobot_lisa.envs.lorel.tasks import Task
from lerobot_lisa.envs.options import names_in
from lerobot_lisa.errors import UserError

FREE_ARM = "_free_arm"
"""Ends the names of groups that were evaluated with the free arm, so that their numbers say that they are others."""


def _plain(text: str) -> str:
    """A name for folders: LeRobot puts videos into one for each group."""
    return re.sub(r"[^a-z0-9]", "_", text)


GROUPS = MappingProxyType(
    {
        "seen": {"seen": SUITES["seen"]},
        "rephrasals": {
            f"rephrasals_{_plain(kind)}": tuple(task for task in SUITES["rephrasals"] if task.kind == kind)
            for kind in KINDS
        },
        "compositions": {"compositions": SUITES["compositions"]},
        "compositions_as_released": {"compositions_as_released": SUITES["compositions_as_released"]},
    }
)
"""Groups of each suite, `{suite: {group: tasks}}`: the rephrasals have one for each kind of instruction."""


def find_groups(names: str, arm: str = "original") -> dict[str, tuple[Task, ...]]:
    """Tasks by group.

    Args:
        names: Suites and instructions, separated by commas.
        arm: Variant of the simulated arm.

    Returns:
        The groups of each suite, in the order given; an instruction is a group of its own, with underscores.

    Raises:
        UserError: If there is no such suite or instruction, one is named twice, or nothing is.
    """
    listed = names_in(names, f"a suite ({', '.join(SUITES)}) or an instruction")
    twice = {name for name in listed if listed.count(name) > 1}
    if twice:
        raise UserError(f"env.task names {sorted(twice)[0]!r} twice: name it once")
    suffix = FREE_ARM if arm == "free" else ""
    return {group + suffix: tasks for name in listed for group, tasks in _groups_of(name)}


def _groups_of(name: str) -> Iterator[tuple[str, tuple[Task, ...]]]:
    if name in GROUPS:
        yield from GROUPS[name].items()
    else:
        yield _plain(name), (find_task(name),)


def tasks_of(group: str) -> tuple[Task, ...]:
    """The tasks of a group by its name in `eval_info.json`, in order; empty if it is no group of LOReL's."""
    name = group.removesuffix(FREE_ARM)
    for groups in GROUPS.values():
        if name in groups:
            return groups[name]
    named = (task for suite in ("rephrasals", "compositions") for task in SUITES[suite])
    return next(((task,) for task in named if _plain(task.instruction) == name), ())


def suite_of(group: str) -> str | None:
    """The suite that a group is one of several of; None if it is the only one, or of no suite."""
    name = group.removesuffix(FREE_ARM)
    found = (suite for suite, groups in GROUPS.items() if len(groups) > 1 and name in groups)
    return next((suite + group.removeprefix(name) for suite in found), None)
