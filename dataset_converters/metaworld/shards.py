"""Shards of demonstrations: states and actions of the experts' successes first, pictures of them afterwards."""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch

from dataset_converters.metaworld.expert import MetaworldEpisode, demonstrate, draw, world
from dataset_converters.seeds import SeedRange
from dataset_converters.shard_files import is_complete, load_arrays, save_arrays, shard_path
from lerobot_lisa.episodes.pictures import resize


class Shard(NamedTuple):
    """A task, and a range of seeds, one episode each."""

    task: str
    seeds: SeedRange

    def path(self, folder: Path, kind: str) -> Path:
        """Where its states or its pictures are."""
        return shard_path(folder, self.seeds, f"{kind}-{self.task}")


def make_states(folder: Path, shard: Shard) -> list[int]:
    """Let the expert try each seed, and keep its successes; a shard that is there already is only read.

    Args:
        folder: Existing directory for shards.
        shard: What to make.

    Returns:
        The seeds of the successes.
    """
    path = shard.path(folder, "states")
    if not is_complete(path):
        with world(shard.task) as env:
            tried = [demonstrate(env, seed) for seed in range(*shard.seeds)]
        episodes = [episode for episode in tried if episode is not None]
        save_arrays(
            path,
            seed=np.array([episode.seed for episode in episodes], np.int64),
            **{f"state_{episode.seed}": episode.state for episode in episodes},
            **{f"action_{episode.seed}": episode.action for episode in episodes},
        )
    return load_arrays(path)["seed"].tolist()


def make_pictures(folder: Path, image_size: int | None, shard: Shard) -> int:
    """Draw the successes of a shard of states; pictures that are there already are only counted.

    Args:
        folder: Where the shard of states is.
        image_size: Pixels along each side; None: as the environment draws them.
        shard: As for the states.

    Returns:
        The number of episodes.
    """
    path, episodes = shard.path(folder, "pictures"), load_states(folder, shard)
    if not is_complete(path):
        with world(shard.task) as env:
            save_arrays(
                path,
                **{
                    str(episode.seed): np.stack([_small(picture, image_size) for picture in draw(env, episode)])
                    for episode in episodes
                },
            )
    return len(episodes)


def _small(picture: np.ndarray, image_size: int | None) -> np.ndarray:
    """Made smaller as in a rollout of our policies, so that it is what they would see there."""
    shown = torch.from_numpy(picture).permute(2, 0, 1)
    return resize(shown, image_size).permute(1, 2, 0).numpy()


def load_states(folder: Path, shard: Shard) -> list[MetaworldEpisode]:
    """The episodes of a shard without their pictures, in the order of their seeds."""
    arrays = load_arrays(shard.path(folder, "states"))
    return [
        MetaworldEpisode(shard.task, seed, arrays[f"state_{seed}"], arrays[f"action_{seed}"])
        for seed in arrays["seed"].tolist()
    ]


def load_pictures(folder: Path, shard: Shard, seed: int) -> np.ndarray:
    """The pictures of one episode, uint8 (T, height, width, 3); the others of its shard stay on the disk."""
    with np.load(shard.path(folder, "pictures"), allow_pickle=False) as pictures:
        return pictures[str(seed)]


def load_episodes(folder: Path, shards: list[Shard], pictures: bool) -> Iterator[MetaworldEpisode]:
    """The episodes of a task's shards, one after the other."""
    for shard in shards:
        for episode in load_states(folder, shard):
            drawn = load_pictures(folder, shard, episode.seed) if pictures else None
            yield MetaworldEpisode(episode.task, episode.seed, episode.state, episode.action, drawn)
