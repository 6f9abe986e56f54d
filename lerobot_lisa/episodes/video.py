"""Decode a stretch of a video once, from front to back."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import av
import numpy as np
from av.video.reformatter import VideoReformatter

from lerobot_lisa.episodes.tables import Array
from lerobot_lisa.errors import UserError


def frames_at(path: Path, times: Sequence[float], tolerance: float) -> Iterator[Array]:
    """Frames nearest to some times, the same that LeRobot's `decode_video_frames` gives with PyAV.

    Which decoder `--dataset.video_backend` names is not told to policies; this is PyAV, which is always there. One
    thread decodes: several stretches are decoded side by side, which wastes less than sharing one.

    Args:
        path: A video.
        times: Seconds from its start, rising.
        tolerance: How far off a frame may be, in seconds.

    Yields:
        (height, width, 3), red, green, blue.

    Raises:
        UserError: The video cannot be decoded, or has no frame at a time.
    """
    try:
        with av.open(str(path)) as container:
            yield from _nearest(container, times, tolerance, path)
    except (av.FFmpegError, OSError, IndexError) as error:
        raise UserError(f"{path}: this is no readable video ({error}): fetch the dataset again") from error


def _nearest(container: Any, times: Sequence[float], tolerance: float, path: Path) -> Iterator[Array]:
    stream = container.streams.video[0]
    stream.codec_context.thread_count = 1
    container.seek(round(times[0] / stream.time_base) - 1, stream=stream)  # to the key frame before it
    decoded = (
        (float(frame.pts * stream.time_base), frame) for frame in container.decode(stream) if frame.pts is not None
    )
    reformatter, none = VideoReformatter(), (float("inf"), None)
    before, now = none, next(decoded, none)
    for time in times:
        while now[0] < time:
            before, now = now, next(decoded, none)
        at, frame = min(before, now, key=lambda found: abs(found[0] - time))
        if frame is None or abs(at - time) > tolerance:
            raise UserError(f"{path}: the video has no frame at {time:.3f} s: fetch the dataset again")
        yield _pixels(reformatter.reformat(frame, format="rgb24"))


def _pixels(frame: Any) -> Array:
    """The memory of a frame, (height, width, 3), without the copy that `to_ndarray` makes."""
    rows = np.frombuffer(frame.planes[0], np.uint8).reshape(frame.height, frame.planes[0].line_size)
    return rows[:, : 3 * frame.width].reshape(frame.height, frame.width, 3)
