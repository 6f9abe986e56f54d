"""What a LOReL episode looks like in a LeRobot dataset."""

from collections.abc import Iterable, Iterator
from typing import Any

import pyarrow as pa

from dataset_converters.lorel.episode import IMAGE_SHAPE, LorelEpisode
from dataset_converters.writer import DatasetLayout, Episode
from lerobot_lisa.envs.lorel.state import ACTION_NAMES, FPS, IGNORED_ACTIONS, STATE_NAMES

EPISODE_COLUMNS = {"seed": pa.int64(), "source_index": pa.int64(), "engine": pa.string()}
"""Columns of meta/episodes beyond LeRobot's own. Converted files know no seed, collected episodes no source index."""


def lorel_layout(repo_id: str, image_quality: str | None, arm: str | None = None) -> DatasetLayout:
    """Layout of a LOReL dataset.

    What must be the same wherever two datasets are merged is in the `info` of a feature, LeRobot's place for facts
    about a feature: its tools carry it along, and refuse to merge datasets that differ in it.

    Args:
        repo_id: name of the dataset.
        image_quality: how its images were rendered; None: it has no images.
        arm: variant of the simulated arm, if it is known.
    """
    state = {"dtype": "float32", "shape": (len(STATE_NAMES),), "names": list(STATE_NAMES)}
    features: dict[str, dict[str, Any]] = {
        "observation.state": state if arm is None else {**state, "info": {"arm": arm}},
    }
    if image_quality is not None:
        features["observation.image"] = {
            "dtype": "image",
            "shape": IMAGE_SHAPE,
            "names": ["height", "width", "channels"],
            "info": {"quality": image_quality},
        }
    features["action"] = {
        "dtype": "float32",
        "shape": (len(ACTION_NAMES),),
        "names": list(ACTION_NAMES),
        "info": {"ignored": list(IGNORED_ACTIONS)},
    }
    return DatasetLayout(repo_id, FPS, features, EPISODE_COLUMNS, robot_type="sawyer")


def to_episodes(episodes: Iterable[LorelEpisode]) -> Iterator[Episode]:
    """Turn LOReL episodes into those of the writer."""
    for episode in episodes:
        frames = {"observation.state": episode.state, "action": episode.action}
        if episode.images is not None:
            frames["observation.image"] = episode.images
        metadata = {"seed": episode.seed, "source_index": episode.source_index, "engine": episode.engine}
        yield Episode(episode.label, frames, metadata)
