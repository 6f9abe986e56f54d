"""What uniformly random actions achieve in every task: the floor that LOReL success rates stand on, as measured.

The table ships with the suites; `python -m lerobot_lisa.analysis.lorel_random_floor --table=FILE` measures it anew.
"""

import json
from functools import cache
from pathlib import Path
from typing import Any

from lerobot_lisa.envs.known_tasks import KnownTask
from lerobot_lisa.envs.lorel.groups import FREE_ARM, suite_of, tasks_of
from lerobot_lisa.envs.lorel.tasks import Task

TABLE = Path(__file__).with_name("random_floor.json")


def floor_key(task: Task) -> str:
    """What the floor depends on: random actions read no instruction, so rephrasals share theirs."""
    return f"{' and '.join(sorted(task.tests))} in {task.steps} steps"


def random_floor(task: Task, arm: str = "original") -> float:
    """Success rate of random actions, in percent."""
    return 100 * table()["successes"][arm][floor_key(task)] / table()["episodes"]


def known_task(group: str, task_id: int) -> KnownTask | None:
    """What is known of a task by its names in `eval_info.json`; None if there is no such task."""
    tasks = tasks_of(group)
    if not 0 <= task_id < len(tasks):
        return None
    task = tasks[task_id]
    floor = random_floor(task, "free" if group.endswith(FREE_ARM) else "original")
    return KnownTask(task.instruction, task.kind, suite_of(group), floor)


@cache
def table() -> dict[str, Any]:
    """The measurement: `successes` by arm and `floor_key`, `episodes` of each, `first_seed`, `engine`."""
    return json.loads(TABLE.read_text(encoding="utf-8"))
