"""Keeps a fair sample of what each skill does: frames of a few chunks, drawn by lot from all of an evaluation."""

import io
from bisect import insort
from dataclasses import dataclass, field
from hashlib import blake2b
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray
from PIL import Image

from lerobot_lisa.analysis.files import aside
from lerobot_lisa.analysis.recording.environment import Moment, render
from lerobot_lisa.errors import UserError

FRAMES_FILE = "frames.parquet"
_SCHEMA = pa.schema(
    {
        "lot": pa.uint64(),
        "code": pa.int32(),
        "group": pa.string(),
        "task_id": pa.int32(),
        "episode": pa.int32(),
        "step": pa.int32(),
        "instruction": pa.string(),
        "frames": pa.list_(pa.binary()),
    }
)


@dataclass(order=True)
class Example:
    """One chunk: what happens while a skill code holds.

    Attributes:
        lot: Number drawn; the smallest are kept.
        code: Skill code.
        group: Task group.
        task_id: Task in its group.
        episode: Episode of the task.
        step: First step of the chunk.
        instruction: What the policy was told.
        frames: PNG files: before the first step, some between, and after the last.
    """

    lot: int
    code: int
    group: str
    task_id: int
    episode: int
    step: int
    instruction: str
    frames: list[bytes] = field(default_factory=list, compare=False)

    def pictures(self) -> list[NDArray[np.uint8]]:
        """The frames, each (height, width, 3)."""
        return [np.asarray(Image.open(io.BytesIO(frame)).convert("RGB")) for frame in self.frames]


class FrameCollector:
    """Watches a recording. The sample depends neither on the order of batches nor on interruptions.

    Every chunk has a lot, a hash of its episode and step, and those with the smallest lots are kept. So few chunks are
    ever drawn: one that will not be kept is known by its lot before its first frame.
    """

    def __init__(self, folder: Path, horizon: int, examples: int = 2, frames: int = 5) -> None:
        """Go on with what is in a folder.

        Args:
            folder: For `FRAMES_FILE`.
            horizon: H, steps that a code holds, or less where another one follows.
            examples: Chunks kept of each code.
            frames: Of each chunk, at least 2.
        """
        self._path, self._horizon, self._examples = folder / FRAMES_FILE, horizon, examples
        self._moments = set(np.linspace(0, horizon, min(frames, horizon + 1)).round().astype(int).tolist()) - {horizon}
        self._kept: dict[int, list[Example]] = {}
        self._began: dict[int, Example] = {}  # by environment: chunks that go on
        self._open: dict[int, Example] = {}  # those of them that are kept
        for example in read(folder) if self._path.is_file() else []:
            self._keep(example)

    def before_step(self, moment: Moment) -> None:
        """Start, go on with and end chunks."""
        if moment.codes is None:
            return
        for index in [i for i in self._open if i not in moment.live]:
            self._end(moment, index)
        for index in moment.live:
            code = int(moment.codes[index])
            began = self._began.get(index)
            if began is None or moment.step in (0, began.step + self._horizon) or began.code != code:
                self._start(moment, index, code)
            if index in self._open and moment.step - self._began[index].step in self._moments:
                self._open[index].frames.append(_png(render(moment.env, index)))

    def after_rollout(self, moment: Moment) -> None:
        """End what is still going on, and write."""
        for index in list(self._open):
            self._end(moment, index)
        examples = [example for code in sorted(self._kept) for example in self._kept[code]]
        with aside(self._path) as partial:
            pq.write_table(pa.Table.from_pylist([vars(example) for example in examples], _SCHEMA), partial)

    def _start(self, moment: Moment, index: int, code: int) -> None:
        if index in self._open:
            self._end(moment, index)
        group, task_id, first = moment.batch
        place = (group, task_id, first + index, moment.step)
        lot = int.from_bytes(blake2b(repr(place).encode(), digest_size=8).digest(), "little")
        example = self._began[index] = Example(lot, code, *place, moment.instructions[index])
        if self._keep(example):
            self._open[index] = example

    def _keep(self, example: Example) -> bool:
        """Put it among the kept ones of its code, if it belongs there and is not there already."""
        kept = self._kept.setdefault(example.code, [])
        if example in kept:  # of a batch that was interrupted after its frames were written
            return False
        insort(kept, example)
        del kept[self._examples :]
        return example in kept

    def _end(self, moment: Moment, index: int) -> None:
        example = self._open.pop(index)
        if example in self._kept[example.code]:
            example.frames.append(_png(render(moment.env, index)))


def read(folder: Path, most: int | None = None) -> list[Example]:
    """The examples in a folder, at most so many of each code, those of a code together; none if none were collected.

    Raises:
        UserError: The file is another.
    """
    path = folder / FRAMES_FILE
    if not path.is_file():
        return []
    try:
        rows = pq.read_table(path).cast(_SCHEMA).to_pylist()
    except (OSError, ValueError, pa.ArrowException) as error:
        raise UserError(f"{path}: not frames of lerobot_lisa ({str(error).splitlines()[0]}): delete it") from error
    by_code: dict[int, list[Example]] = {}
    for row in rows:
        by_code.setdefault(row["code"], []).append(Example(**row))
    return [example for examples in by_code.values() for example in examples[:most]]


def _png(picture: NDArray[np.uint8]) -> bytes:
    file = io.BytesIO()
    Image.fromarray(picture).save(file, "png")
    return file.getvalue()
