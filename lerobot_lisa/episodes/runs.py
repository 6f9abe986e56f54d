"""Runs of frames with one task: what LISA calls an episode.

LeRobot stores a task for every frame, and recordings may hold several tasks one after another. A rollout starts anew
with every instruction, so training does too. Where each episode has one task, runs are the dataset's episodes.
"""

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from lerobot_lisa.episodes.check import Array, episode_spans
from lerobot_lisa.episodes.tables import tables, values

if TYPE_CHECKING:
    from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata


class Runs(NamedTuple):
    """Stretches of a dataset's frames, in order.

    Attributes:
        starts: First frame of each run, (R,).
        lengths: Frames of each, (R,).
        episodes: The dataset's episode that each lies in, (R,).
        tasks: The `task_index` of each, (R,); -1 where the data file is not there.
    """

    starts: Array
    lengths: Array
    episodes: Array
    tasks: Array


def task_runs(meta: "LeRobotDatasetMetadata") -> Runs:
    """The runs of a dataset. Episodes whose data files are not there are one run each."""
    starts, _ = episode_spans(meta)
    tasks = np.full(meta.total_frames, -1)
    for path, table in tables(Path(meta.root), ["index", "task_index"]):
        frames, task = values(path, table, "index"), values(path, table, "task_index")
        known = (frames >= 0) & (frames < len(tasks))  # others are refused when they are read
        tasks[frames[known]] = task[known]
    begins = np.zeros(meta.total_frames, bool)
    begins[1:] = tasks[1:] != tasks[:-1]
    begins[starts] = True
    firsts = np.flatnonzero(begins)
    episodes = np.searchsorted(starts, firsts, side="right") - 1
    return Runs(firsts, np.diff(firsts, append=meta.total_frames), episodes, tasks[firsts])
