"""What a world knows of its tasks before any policy runs, such as what random actions achieve; by `--env.type`."""

from typing import NamedTuple

from lerobot.envs.configs import EnvConfig


class KnownTask(NamedTuple):
    """A task that a world knows.

    Attributes:
        instruction: What the policy is told.
        kind: Of instruction, such as "unseen verb".
        suite: The suite that the task's group is one of several of; None: there is none.
        random_actions: Success rate of random actions, in percent.
    """

    instruction: str
    kind: str
    suite: str | None
    random_actions: float


def known_task(world: str | None, group: str, task_id: int) -> KnownTask | None:
    """A task by the names that LeRobot's evaluation gives it; None if the world does not know it.

    Args:
        world: `--env.type`; LeRobot's registry has its configuration, whose `known_task` answers, if it has one.
        group: Task group. Foreign worlds may have groups of the same name.
        task_id: Task in its group.
    """
    ask = getattr(EnvConfig.get_known_choices().get(world), "known_task", None)
    return ask(group, task_id) if ask else None
