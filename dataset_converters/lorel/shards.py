"""Shards of random play: states and labels first, images rendered from them afterwards."""

from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np

from dataset_converters.lorel.episode import LorelEpisode, is_labelled
from dataset_converters.lorel.random_play import play
from dataset_converters.seeds import SeedRange
from dataset_converters.shard_files import is_complete, load_arrays, save_arrays, shard_path
from lerobot_lisa.envs.lorel.camera import Camera
from lerobot_lisa.envs.lorel.scene import engine
from lerobot_lisa.envs.lorel.simulator import LorelSimulator

# one per process: compiling the scene and opening a context cost more than an episode
_simulator = cache(LorelSimulator)
_cameras: dict[str, Camera] = {}


def make_states(folder: Path, arm: str, seeds: SeedRange) -> int:
    """Play an episode for each seed; a shard that is there already is only counted.

    Args:
        folder: existing directory for shards.
        arm: variant of the simulated arm.
        seeds: one episode each.

    Returns:
        The number of episodes.
    """
    path = shard_path(folder, seeds, "states")
    if not is_complete(path):
        episodes = [play(_simulator(arm), seed) for seed in range(*seeds)]
        save_arrays(
            path,
            state=np.stack([episode.state for episode in episodes]),
            action=np.stack([episode.action for episode in episodes]),
            label=np.array([episode.label for episode in episodes], np.str_),
        )
    return seeds.stop - seeds.first


def make_images(folder: Path, quality: str, keep_unlabelled: bool, seeds: SeedRange) -> int:
    """Render the episodes of a shard of states that will be kept; images that are there already are only counted.

    Args:
        folder: where the shard of states is.
        quality: name of the image quality.
        keep_unlabelled: whether episodes in which nothing happened are kept.
        seeds: as for the states.

    Returns:
        The number of episodes, rendered or not.
    """
    path = shard_path(folder, seeds, "images")
    if not is_complete(path):
        camera = _cameras.setdefault(quality, Camera(quality))
        episodes = load_episodes(folder, seeds, keep_unlabelled)
        save_arrays(
            path,
            **{str(episode.seed): np.stack([camera.frame(state) for state in episode.state]) for episode in episodes},
        )
    return seeds.stop - seeds.first


def load_episodes(
    folder: Path, seeds: SeedRange, keep_unlabelled: bool, images: bool = False
) -> Iterator[LorelEpisode]:
    """The episodes of a shard that are kept, in the order of their seeds, with or without their images."""
    states = load_arrays(shard_path(folder, seeds, "states"))
    pictures = load_arrays(shard_path(folder, seeds, "images")) if images else {}
    for seed, state, action, label in zip(
        range(*seeds), states["state"], states["action"], states["label"], strict=True
    ):
        if keep_unlabelled or is_labelled(label):
            yield LorelEpisode(str(label), state, action, pictures.get(str(seed)), seed=seed, engine=engine())


def close_cameras() -> None:
    """Give this process's OpenGL contexts back; otherwise they complain at its end."""
    while _cameras:
        _cameras.popitem()[1].close()
