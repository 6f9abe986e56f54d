"""Episodes in the original HDF5 + CSV layout, so that code for the original data set can read them."""

import errno
import os
import shutil
from collections.abc import Iterable
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

    HDF5 crashes at the end of the program when the disk is full. It therefore only lays the file out; the values go
    straight to where it has put the arrays.

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
    offsets = _lay_out(folder / DATA_FILE, count, image_quality, engine)
    with (folder / DATA_FILE).open("r+b") as file:
        for index, episode in enumerate(episodes):
            values = {"state": episode.state, "actions": episode.action}
            if episode.images is not None:
                values["ims"] = episode.images / np.float32(255)
            for name, array in values.items():
                file.seek(offsets[name] + index * array.nbytes)
                file.write(array.astype("<f4").tobytes())
            labels.append(episode.label)
    write_labels(folder / LABELS_FILE, labels)
    return DatasetTotals(count, count * EPISODE_STEPS, len(set(labels)))


def _lay_out(path: Path, count: int, image_quality: str | None, engine: str) -> dict[str, int]:
    """Create a file whose arrays have their place but no values, and return where each begins."""
    names = [name for name in SHAPES if image_quality is not None or name != "ims"]
    shapes = {name: (count, EPISODE_STEPS, *SHAPES[name]) for name in names}
    if shutil.disk_usage(path.parent).free < sum(4 * int(np.prod(shape)) for shape in shapes.values()):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    with h5py.File(path, "w") as file:
        group = file.create_group(GROUP)
        group.attrs["engine"] = engine
        if image_quality is not None:
            group.attrs[QUALITY] = image_quality
        return {name: _place(group, name, shape) for name, shape in shapes.items()}


def _place(group: h5py.Group, name: str, shape: tuple[int, ...]) -> int:
    """Give an array its place in the file, and return where it begins, in bytes."""
    layout = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    layout.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
    layout.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
    layout.set_obj_track_times(False)  # the same bytes whenever it is written
    array = h5py.h5d.create(group.id, name.encode(), h5py.h5t.IEEE_F32LE, h5py.h5s.create_simple(shape), layout)
    return int(array.get_offset())
