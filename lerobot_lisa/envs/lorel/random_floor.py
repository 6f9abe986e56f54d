"""What uniformly random actions achieve in every task: the floor that LOReL success rates stand on, as measured.

The table ships with the suites; `python -m lerobot_lisa.analysis.lorel_random_floor --table` measures it anew.
"""

import json
from functools import cache
from pathlib import Path
from typing import Any

from lerobot_lisa.envs.lorel.tasks import Task

TABLE = Path(__file__).with_name("random_floor.json")


def floor_key(task: Task) -> str:
    """What the floor depends on: random actions read no instruction, so rephrasals share theirs."""
    return f"{' and '.join(sorted(task.tests))} in {task.steps} steps"


def random_floor(task: Task, arm: str = "original") -> float:
    """Success rate of random actions, in percent."""
    return 100 * table()["successes"][arm][floor_key(task)] / table()["episodes"]


@cache
def table() -> dict[str, Any]:
    """The measurement: `successes` by arm and `floor_key`, `episodes` of each, `first_seed`, `engine`."""
    return json.loads(TABLE.read_text(encoding="utf-8"))
