"""Bulk writer of LeRobotDataset v3.0: a stream of whole episodes in, the files that LeRobot's own writer makes out."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata
from lerobot.datasets.feature_utils import get_hf_features_from_features
from lerobot.datasets.io_utils import write_info, write_stats, write_tasks
from lerobot.datasets.language import language_feature_info
from lerobot.datasets.utils import DEFAULT_EPISODES_PATH
from lerobot.utils.constants import DEFAULT_FEATURES

from dataset_converters.columns import check_episode, check_features, frame_table
from dataset_converters.episode_rows import EpisodeRow, episode_table
from dataset_converters.language import language_column
from dataset_converters.parquet_files import ParquetFiles
from dataset_converters.stats import RunningStats, episode_stats
from dataset_converters.subtasks import Subtask, check_subtasks
from lerobot_lisa.errors import UserError

_ROWS_PER_BLOCK = 200  # episodes whose metadata is held in memory before it is written


@dataclass(frozen=True)
class Episode:
    """One whole episode: what is seen and done at each of its T frames, and what is known about it as a whole."""

    task: str
    frames: Mapping[str, np.ndarray]  # feature name -> (T, *shape); shape (1,) may also be given as (T,)
    metadata: Mapping[str, int | float | str | None] = field(default_factory=dict)
    subtasks: Sequence[Subtask] = ()  # kept where the layout has them


@dataclass(frozen=True)
class DatasetLayout:
    """What a dataset looks like before the first episode is written."""

    repo_id: str
    fps: int
    features: Mapping[str, dict[str, Any]]  # as in LeRobot: {"dtype", "shape", "names"}, in column order
    episode_columns: Mapping[str, pa.DataType] = field(default_factory=dict)  # type of each `Episode.metadata` key
    robot_type: str | None = None
    data_files_size_in_mb: int | None = None  # None: LeRobot's default, 100
    subtasks: bool = False  # whether episodes have some, in LeRobot's language columns


@dataclass(frozen=True)
class DatasetTotals:
    """Size of a dataset that was written."""

    episodes: int
    frames: int
    tasks: int


def write_dataset(root: Path, layout: DatasetLayout, episodes: Iterable[Episode]) -> DatasetTotals:
    """Write a LeRobotDataset v3.0 of `episodes`, in their order.

    Memory is bounded by one block of episodes plus the distinct tasks. The bytes depend on the arguments only.

    Args:
        root: directory to create; see `dataset_converters.staging` for building it aside.
        layout: features and settings. Numeric features of rank 1 and `image` features are supported.
        episodes: any iterable; it is read once.

    Returns:
        How much was written.

    Raises:
        UserError: if a feature is not supported, an episode does not fit the layout, or there is no episode at all.
    """
    check_features(layout.features)
    if layout.fps < 1:
        raise UserError(f"fps is {layout.fps}: give a whole number of frames per second, at least 1")
    writer = _DatasetWriter(root, layout)
    try:
        for episode in episodes:
            writer.add(episode)
        return writer.finish()
    finally:
        writer.close()


class _DatasetWriter:
    """State of one dataset on its way to disk."""

    def __init__(self, root: Path, layout: DatasetLayout) -> None:
        self._root, self._layout = root, layout
        self._language = language_feature_info() if layout.subtasks else {}
        self._meta = LeRobotDatasetMetadata.create(
            repo_id=layout.repo_id,
            fps=layout.fps,
            features={**layout.features, **self._language},
            robot_type=layout.robot_type,
            root=root,
            use_videos=False,
            data_files_size_in_mb=layout.data_files_size_in_mb,
        )
        limits = (self._meta.data_files_size_in_mb * 1024**2, self._meta.chunks_size)
        self._schema = get_hf_features_from_features(self._meta.features).arrow_schema
        self._data = ParquetFiles(root, self._meta.data_path, *limits)
        self._rows = ParquetFiles(root, DEFAULT_EPISODES_PATH, *limits)
        self._block: list[EpisodeRow] = []
        self._stats = RunningStats()
        self._tasks: dict[str, int] = {}
        self._episodes = self._frames = 0

    def add(self, episode: Episode) -> None:
        length = check_episode(self._episodes, episode.task, episode.frames, self._layout.features)
        numbers = {**episode.frames, **self._bookkeeping(episode.task, length)}
        columns = {**numbers, **self._language_columns(episode, length)}
        place = self._data.write(frame_table(columns, self._meta.features, self._schema))
        self._block.append(
            EpisodeRow(
                episode_index=self._episodes,
                task=episode.task,
                length=length,
                first_frame=self._frames,
                data_file=place,
                metadata=episode.metadata,
                stats=episode_stats(numbers, self._meta.features),
            )
        )
        self._episodes += 1
        self._frames += length
        if len(self._block) == _ROWS_PER_BLOCK:
            self._flush()

    def _language_columns(self, episode: Episode, length: int) -> dict[str, pa.Array]:
        if self._language:
            check_subtasks(episode.subtasks, length, f"episode {self._episodes}: the subtasks")
        times = (np.arange(length) / self._layout.fps).astype(np.float32)
        return {
            key: language_column(key, episode.subtasks, times, self._schema.field(key).type) for key in self._language
        }

    def _bookkeeping(self, task: str, length: int) -> dict[str, np.ndarray]:
        """The five columns that LeRobot adds to every dataset, each (T,)."""
        frame_index = np.arange(length, dtype=np.int64)
        task_index = self._tasks.setdefault(task, len(self._tasks))
        columns: dict[str, np.ndarray] = {
            "timestamp": (frame_index / self._layout.fps).astype(np.float32),
            "frame_index": frame_index,
            "episode_index": np.full(length, self._episodes),
            "index": self._frames + frame_index,
            "task_index": np.full(length, task_index),
        }
        assert columns.keys() == DEFAULT_FEATURES.keys()
        return columns

    def _flush(self) -> None:
        if self._block:
            self._stats.update([row.stats for row in self._block])
            place = self._rows.place_for(len(self._block))
            self._rows.write(episode_table(self._block, place, self._layout.episode_columns))
            self._block.clear()

    def finish(self) -> DatasetTotals:
        if not self._episodes:
            raise UserError(f"{self._root}: there is no episode to write")
        self._flush()
        info = self._meta.info
        info.total_episodes, info.total_frames, info.total_tasks = self._episodes, self._frames, len(self._tasks)
        info.splits = {"train": f"0:{self._episodes}"}
        tasks = pd.DataFrame({"task_index": range(len(self._tasks))}, index=pd.Index(list(self._tasks), name="task"))
        write_tasks(tasks, self._root)
        write_stats(self._stats.result(), self._root)
        write_info(info, self._root)
        return DatasetTotals(self._episodes, self._frames, len(self._tasks))

    def close(self) -> None:
        self._data.close()
        self._rows.close()
