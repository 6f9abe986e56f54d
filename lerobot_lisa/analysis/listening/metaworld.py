"""What listening is measured against in Meta-World: the steps of the scripted experts."""

from functools import cache

from dataset_converters.metaworld.expert import demonstrate
from lerobot_lisa.envs.metaworld_states.env import MetaworldStatesEnv

_world = cache(MetaworldStatesEnv)  # one per task: building it costs more than an episode


def demonstrator_steps(task: str, seed: int) -> int | None:
    """How many steps the task's expert needs from the start of a seed; None if it fails."""
    episode = demonstrate(_world(task), seed)
    return None if episode is None else len(episode.action)
