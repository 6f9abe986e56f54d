"""How far work on frames has come: a bar, and lines in the log where there is no terminal to show it."""

import logging
import time
from threading import Lock

from tqdm import tqdm

SECONDS_BETWEEN_LINES = 10.0


class FrameProgress:
    """Counts frames, from any thread.

    Args:
        what: Is being done, such as "Decoding pictures".
        total: Frames.
    """

    def __init__(self, what: str, total: int) -> None:
        self._bar = tqdm(total=total, desc=what, unit="frame", disable=None, leave=False)
        self._what, self._total, self._done = what, total, 0
        self._lock, self._said = Lock(), time.monotonic()

    def add(self, frames: int) -> None:
        """So many more are done."""
        with self._lock:
            self._bar.update(frames)
            self._done += frames
            if self._bar.disable and time.monotonic() > self._said + SECONDS_BETWEEN_LINES:
                self._said = time.monotonic()
                logging.info("%s: %d of %d frames", self._what, self._done, self._total)

    def close(self) -> None:
        """Take the bar away."""
        self._bar.close()
