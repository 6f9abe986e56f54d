"""Films episodes while LeRobot's own evaluation runs them, with the skill code written on every frame."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from lerobot_lisa.analysis.recording.environment import Moment, render

_CAPTION = 18  # pixels, even: video codecs want even sizes
_MARGIN = 4


class VideoWriter:
    """Watches a recording and writes `GROUP_TASK/episode_NUMBER.mp4` for the first episodes of each task.

    LeRobot's own videos would show no skill code, and its `render` draws every environment of a batch to keep a few.
    """

    def __init__(self, folder: Path, episodes: int) -> None:
        """Prepare.

        Args:
            folder: For the videos, a folder in it for each task.
            episodes: Of each task that are filmed, the first ones.
        """
        self._folder, self._episodes = folder, episodes
        self._films: dict[int, list[NDArray[np.uint8]]] = {}  # by environment

    def before_step(self, moment: Moment) -> None:
        """Add what is seen now to the films that go on, and finish the others."""
        for index in [i for i in self._films if i not in moment.live]:
            self._finish(moment, index)
        for index in moment.live:
            if moment.batch.first + index < self._episodes:
                code = "" if moment.codes is None else f"skill {moment.labels[moment.codes[index]]}"
                frame = captioned(render(moment.env, index), f"step {moment.step}  {code}")
                self._films.setdefault(index, []).append(frame)

    def after_rollout(self, moment: Moment) -> None:
        """Finish what is still going on."""
        for index in list(self._films):
            self._finish(moment, index)

    def _finish(self, moment: Moment, index: int) -> None:
        from lerobot.utils.io_utils import write_video

        frames = [*self._films.pop(index), captioned(render(moment.env, index), "end")]
        path = self._folder / moment.batch.folder / f"episode_{moment.batch.first + index}.mp4"
        path.parent.mkdir(parents=True, exist_ok=True)
        write_video(path, frames, moment.env.unwrapped.metadata["render_fps"])


def captioned(frame: NDArray[np.uint8], text: str) -> NDArray[np.uint8]:
    """A frame (height, width, 3) with a line of text above it, (height + 18, width, 3)."""
    height, width = frame.shape[:2]
    picture = Image.new("RGB", (width, height + _CAPTION), "white")
    picture.paste(Image.fromarray(frame), (0, _CAPTION))
    ImageDraw.Draw(picture).text((_MARGIN, 2), text, fill="black", font=ImageFont.load_default(12))
    return np.asarray(picture)
