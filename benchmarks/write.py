"""Writing datasets in bulk against LeRobot's `add_frame` and `save_episode`, of states and of images."""

import argparse
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset

from benchmarks.measuring import contest
from benchmarks.table import Row, ratio_row
from dataset_converters.babyai.bot import demonstrate
from dataset_converters.babyai.schema import FEATURES, FPS, to_episodes
from dataset_converters.writer import DatasetLayout, Episode, write_dataset
from lerobot_lisa.envs.babyai.env import BabyAIEnv
from lerobot_lisa.envs.babyai.levels import make_level

FIRST_SEED = 1_000_000
IMAGE = {"dtype": "image", "shape": (64, 64, 3), "names": ["height", "width", "channels"]}


def rows(options: argparse.Namespace) -> list[Row]:
    return [
        _row("states", FEATURES, list(_states(20)), 30, options.repeats),
        _row(
            "images of 64 x 64",
            {"observation.image": IMAGE, "action": FEATURES["action"]},
            list(_images(100)),
            3,
            options.repeats,
        ),
    ]


def _row(what: str, features: dict[str, Any], episodes: Sequence[Episode], aim: float, repeats: int) -> Row:
    frames = sum(len(episode.frames["action"]) for episode in episodes)
    with tempfile.TemporaryDirectory() as folder:
        roots = (Path(folder) / str(i) for i in range(2 * repeats + 2))

        def ours() -> int:
            write_dataset(next(roots), DatasetLayout("me/benchmark", FPS, features), episodes)
            return frames

        def theirs() -> int:
            write_with_lerobot(next(roots), features, episodes)
            return frames

        result = contest(ours, theirs, repeats)
    return ratio_row(
        f"writing {what}",
        "LeRobot's `add_frame`/`save_episode`",
        aim,
        result,
        "frames",
        episodes=len(episodes),
        frames=frames,
    )


def write_with_lerobot(root: Path, features: dict[str, Any], episodes: Sequence[Episode]) -> None:
    """What `write_dataset` does, with LeRobot's writer."""
    dataset = LeRobotDataset.create("me/benchmark", fps=FPS, features=features, root=root, use_videos=False)
    for episode in episodes:
        for i in range(len(episode.frames["action"])):
            frame = {key: values[i].reshape(features[key]["shape"]) for key, values in episode.frames.items()}
            dataset.add_frame({**frame, "task": episode.task})
        dataset.save_episode()
    dataset.finalize()


def _states(count: int) -> Iterator[Episode]:
    level = make_level("GoToSeq")
    tried = (demonstrate(level, "GoToSeq", seed) for seed in range(FIRST_SEED, FIRST_SEED + count))
    for episode in to_episodes((demo, None) for demo in tried if demo is not None):
        yield Episode(episode.task, episode.frames)


def _images(count: int) -> Iterator[Episode]:
    """Drawings of a room in which the bot is at work."""
    level, env = make_level("GoToLocal"), BabyAIEnv("GoToLocal", tile_size=8)
    for seed in range(FIRST_SEED, FIRST_SEED + count):
        demo = demonstrate(level, "GoToLocal", seed)
        if demo is None:
            continue
        env.reset(seed=seed)
        images = []
        for action in demo.action:
            images.append(env.render())
            env.step(action)
        yield Episode(demo.instruction, {"observation.image": np.stack(images), "action": demo.action})
