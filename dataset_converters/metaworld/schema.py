"""What a Meta-World episode looks like in a LeRobot dataset: what LeRobot's `--env.type=metaworld` shows."""

from collections.abc import Iterable, Iterator
from typing import Any

import pyarrow as pa
from lerobot.configs import FeatureType
from lerobot.envs.configs import MetaworldEnv
from lerobot.utils.constants import ACTION, OBS_IMAGE, OBS_STATE

from dataset_converters.metaworld.expert import MetaworldEpisode, engine
from dataset_converters.writer import DatasetLayout, Episode
from lerobot_lisa.envs.metaworld_states.tasks import instructions

STATE_NAMES = ("x", "y", "z", "gripper")
"""Where the hand is, in metres, and how far the gripper is open, from 0 to 1."""

ACTION_NAMES = ("x", "y", "z", "gripper")
"""How far the point that the hand follows moves, in centimetres, and how hard the fingers close; -1 to 1 each."""

EPISODE_COLUMNS = {"metaworld_task": pa.string(), "seed": pa.int64(), "engine": pa.string()}
"""Columns of meta/episodes beyond LeRobot's own."""


def metaworld_layout(repo_id: str, pictures: bool, image_size: int | None = None) -> DatasetLayout:
    """Layout of a Meta-World dataset, read from LeRobot's configuration of the environment.

    Args:
        repo_id: name of the dataset.
        pictures: whether it has any.
        image_size: pixels along each side of them; None: the environment's.
    """
    env = MetaworldEnv()
    shapes = {env.features_map[name]: feature for name, feature in env.features.items()}
    features: dict[str, dict[str, Any]] = {OBS_STATE: _numbers(shapes[OBS_STATE].shape, STATE_NAMES)}
    if pictures:
        assert shapes[OBS_IMAGE].type is FeatureType.VISUAL
        height, width, channels = shapes[OBS_IMAGE].shape
        shape = (image_size or height, image_size or width, channels)
        features[OBS_IMAGE] = {"dtype": "image", "shape": shape, "names": ["height", "width", "channels"]}
    features[ACTION] = _numbers(shapes[ACTION].shape, ACTION_NAMES)
    return DatasetLayout(repo_id, env.fps, features, EPISODE_COLUMNS, robot_type="sawyer")


def _numbers(shape: tuple[int, ...], names: tuple[str, ...]) -> dict[str, Any]:
    return {"dtype": "float32", "shape": shape, "names": list(names)}


def to_episodes(episodes: Iterable[MetaworldEpisode]) -> Iterator[Episode]:
    """Turn Meta-World episodes into those of the writer; the task is what LeRobot's environment tells policies."""
    made, told = engine(), instructions()
    for episode in episodes:
        frames = {OBS_STATE: episode.state, ACTION: episode.action}
        if episode.pictures is not None:
            frames[OBS_IMAGE] = episode.pictures
        metadata: dict[str, str | int] = {"metaworld_task": episode.task, "seed": episode.seed, "engine": made}
        yield Episode(told[episode.task], frames, metadata)
