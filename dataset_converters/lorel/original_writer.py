"""Episodes in the original HDF5 + CSV layout, so that code for the original data set can read them."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import h5py
import numpy as np

from dataset_converters.lorel.episode import LorelEpisode
from dataset_converters.lorel.labels_csv import write_labels
from dataset_converters.lorel.original_file import GROUP, QUALITY, SHAPES
from dataset_converters.writer import DatasetTotals
from lerobot_lisa.envs.lorel.state import EPISODE_STEPS

DATA_FILE, LABELS_FILE = "data.hdf5", "labels.csv"


def write_original(
    folder: Path, count: int, episodes: Iterable[LorelEpisode], image_quality: str | None, engine: str
) -> DatasetTotals:
    """Write `data.hdf5` and `labels.csv`.

    Args:
        folder: directory to create.
        count: number of episodes.
        episodes: that many, of `EPISODE_STEPS` frames, read once.
        image_quality: of their images; None: they have none, and the array `ims` is left out.
        engine: that simulated them.

    Returns:
        How much was written.

    Raises:
        OSError: if the disk is full or cannot be written.
    """
    folder.mkdir(parents=True)
    labels: list[str] = []
    with _writing(folder / DATA_FILE) as file:
        group = file.create_group(GROUP)
        group.attrs["engine"] = engine
        if image_quality is not None:
            group.attrs[QUALITY] = image_quality
        names = [name for name in SHAPES if image_quality is not None or name != "ims"]
        arrays = {name: _array(group, name, count) for name in names}
        for index, episode in enumerate(episodes):
            arrays["state"][index], arrays["actions"][index] = episode.state, episode.action
            if episode.images is not None:
                arrays["ims"][index] = episode.images / np.float32(255)
            labels.append(episode.label)
    write_labels(folder / LABELS_FILE, labels)
    return DatasetTotals(count, count * EPISODE_STEPS, len(set(labels)))


def _array(group: h5py.Group, name: str, count: int) -> h5py.Dataset:
    shape = (count, EPISODE_STEPS, *SHAPES[name])
    return group.create_dataset(name, shape, np.float32, fill_time="never")  # all of it will be written


@contextmanager
def _writing(path: Path) -> Iterator[h5py.File]:
    """An HDF5 file whose errors, whatever their type, are the operating system's."""
    try:
        with h5py.File(path, "w") as file:
            yield file
    except RuntimeError as error:  # what h5py raises if closing fails
        raise OSError(" ".join(str(error).split())) from error
