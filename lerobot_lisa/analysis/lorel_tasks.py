"""What the suites know of LOReL's tasks in an `eval_info.json`: instructions, and what random actions achieve."""

from collections.abc import Mapping, Sequence

from lerobot_lisa.envs.lorel.groups import FREE_ARM, suite_of, tasks_of
from lerobot_lisa.envs.lorel.random_floor import random_floor
from lerobot_lisa.envs.lorel.tasks import Task

TaskName = tuple[str, int]
"""Group and task id."""


def find_task(name: TaskName) -> Task | None:
    """The task of that name; None if it is not LOReL's."""
    group, task_id = name
    tasks = tasks_of(group)
    return tasks[task_id] if 0 <= task_id < len(tasks) else None


def instruction(name: TaskName) -> str | None:
    """What the policy was told; None if the task is not LOReL's."""
    task = find_task(name)
    return task.instruction if task else None


def floor(outcomes: Mapping[TaskName, Sequence[bool]]) -> float | None:
    """Success rate of random actions in percent, over as many episodes of each task; None if a task is not LOReL's."""
    total = 0.0
    for name, listed in outcomes.items():
        task = find_task(name)
        if task is None:
            return None
        total += len(listed) * random_floor(task, "free" if name[0].endswith(FREE_ARM) else "original")
    return total / sum(map(len, outcomes.values()))


def suite(name: TaskName) -> str | None:
    """The suite that the task's group is one of several of, if there is one."""
    return suite_of(name[0])
