"""What listening is measured against in Meta-World: the steps of the scripted experts."""

from functools import cache

from dataset_converters.metaworld.expert import demonstrate  # first: it chooses how MuJoCo draws

from lerobot.envs.metaworld import DIFFICULTY_TO_TASKS, MetaworldEnv  # isort: skip


def task_of(group: str, task_id: int) -> str:
    """The task that LeRobot's evaluation calls so: a group of difficulty has several, others are tasks themselves."""
    return DIFFICULTY_TO_TASKS.get(group, [group])[task_id].removeprefix("metaworld-")


@cache
def _world(task: str) -> MetaworldEnv:
    """One per process: building it costs more than an episode. Nothing is drawn in it, so there is nothing to close."""
    return MetaworldEnv(task, obs_type="pixels_agent_pos")


def demonstrator_steps(task: str, seed: int) -> int | None:
    """How many steps the task's expert needs from the start of this seed; None if it fails."""
    episode = demonstrate(_world(task), seed)
    return None if episode is None else len(episode.action)
