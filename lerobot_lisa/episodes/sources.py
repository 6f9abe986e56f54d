"""Where pictures come from: videos of many episodes each, or images in the data files."""

import io
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np
import PIL.Image
import pyarrow.parquet as pq

from lerobot_lisa.episodes.check import episode_spans
from lerobot_lisa.episodes.tables import Array, check_columns, tables, values
from lerobot_lisa.episodes.video import frames_at
from lerobot_lisa.errors import UserError

if TYPE_CHECKING:
    from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata

_MODES = {1: "L", 3: "RGB"}  # Pillow's, by channels


class PictureSource(Protocol):
    """Pictures of one feature.

    Attributes:
        files: Number of the file that holds each episode, (episodes,); neighbours in one file can be read together.
    """

    files: Array

    def read(self, first: int, last: int) -> Iterator[Array]:
        """Pictures, bytes (height, width, channels), of all frames from one episode to another of the same file.

        Raises:
            UserError: One is missing or cannot be decoded.
        """
        ...


def picture_source(meta: "LeRobotDatasetMetadata", key: str) -> PictureSource:
    """What a dataset has for a feature of type image or video."""
    return VideoSource(meta, key) if meta.features[key]["dtype"] == "video" else ImageSource(meta, key)


def stored_shape(meta: "LeRobotDatasetMetadata", key: str) -> tuple[int, int, int]:
    """Channels, height and width of a feature's pictures.

    Raises:
        UserError: They are no pictures in colours or shades of grey.
    """
    feature = meta.features[key]
    shape, names = list(feature["shape"]), list(feature.get("names") or [])
    if names[2:] in (["channel"], ["channels"]):  # as LeRobot tells the two orders apart
        shape = [shape[2], *shape[:2]]
    if len(shape) != 3 or shape[0] not in _MODES or key in meta.depth_keys:
        raise UserError(
            f"{meta.root}: `{key}` holds no pictures of one or three colours: leave it out of --policy.input_features"
        )
    channels, height, width = shape
    return channels, height, width


class VideoSource:
    """Pictures from videos."""

    def __init__(self, meta: "LeRobotDatasetMetadata", key: str) -> None:
        self._meta, self._key = meta, key
        self._starts, self._stops = episode_spans(meta)
        self.files = _file_numbers(meta, f"videos/{key}")
        self._offsets = np.asarray(meta.episodes[f"videos/{key}/from_timestamp"][:])
        self._times = _timestamps(meta)

    def read(self, first: int, last: int) -> Iterator[Array]:
        """As the protocol says."""
        path = Path(self._meta.root) / self._meta.get_video_file_path(first, self._key)
        times = [
            self._offsets[episode] + self._times[self._starts[episode] : self._stops[episode]].astype(np.float64)
            for episode in range(first, last + 1)
        ]
        return frames_at(path, np.concatenate(times).tolist(), tolerance=0.5 / self._meta.fps)


class ImageSource:
    """Pictures from the data files."""

    def __init__(self, meta: "LeRobotDatasetMetadata", key: str) -> None:
        self._meta, self._key = meta, key
        self._starts, self._stops = episode_spans(meta)
        self._mode = _MODES[stored_shape(meta, key)[0]]
        self.files = _file_numbers(meta, "data")

    def read(self, first: int, last: int) -> Iterator[Array]:
        """As the protocol says."""
        path = Path(self._meta.root) / self._meta.get_data_file_path(first)
        check_columns(path, ["index", self._key])
        expected = iter(range(self._starts[first], self._stops[last]))
        with pq.ParquetFile(path) as file:
            for group in range(file.num_row_groups):
                frames = file.read_row_group(group, columns=["index"]).column("index").to_numpy()
                rows = np.flatnonzero((frames >= self._starts[first]) & (frames < self._stops[last]))
                if not len(rows):
                    continue
                stored = file.read_row_group(group, columns=[self._key]).column(0).combine_chunks().field("bytes")
                for row in rows[np.argsort(frames[rows])]:
                    if frames[row] != next(expected):
                        raise UserError(f"{path}: frames are not in order: fetch the dataset again")
                    yield self._decoded(stored[row].as_py(), path, frames[row])

    def _decoded(self, stored: bytes | None, path: Path, frame: int) -> Array:
        try:
            picture = np.array(PIL.Image.open(io.BytesIO(stored or b"")).convert(self._mode))
        except (OSError, ValueError, PIL.Image.DecompressionBombError) as error:
            raise UserError(f"{path}: `{self._key}` of frame {frame} is no readable image: {error}") from error
        return picture.reshape(*picture.shape[:2], -1)


def _file_numbers(meta: "LeRobotDatasetMetadata", part: str) -> Array:
    places = np.stack([np.asarray(meta.episodes[f"{part}/{name}_index"][:]) for name in ("chunk", "file")], axis=1)
    return np.unique(places, axis=0, return_inverse=True)[1].reshape(-1)


def _timestamps(meta: "LeRobotDatasetMetadata") -> Array:
    """Seconds since the beginning of its episode of each frame, (frames,)."""
    times = np.zeros(meta.total_frames, np.float32)
    for path, table in tables(Path(meta.root), ["index", "timestamp"]):
        times[values(path, table, "index")] = values(path, table, "timestamp")
    return times
