"""LeRobot's language columns, with the subtasks of episodes as `lerobot-annotate` stores them."""

from collections.abc import Sequence

import numpy as np
import pyarrow as pa
from lerobot.datasets.language import LANGUAGE_PERSISTENT

from dataset_converters.subtasks import Subtask

_ROW = {"role": "assistant", "style": "subtask"}  # what lerobot-annotate writes of every subtask


def language_column(key: str, subtasks: Sequence[Subtask], times: np.ndarray, kind: pa.DataType) -> pa.Array:
    """A language column of one episode.

    Args:
        key: `language_persistent`, in which every frame repeats all subtasks, or `language_events`, which stays empty.
        subtasks: Of the episode.
        times: Seconds since its beginning of each frame, (T,).
        kind: LeRobot's type of the column.
    """
    listed = subtasks if key == LANGUAGE_PERSISTENT else []
    known = {name: [value] * len(listed) for name, value in _ROW.items()}
    known["content"] = [subtask.text for subtask in listed]
    known["timestamp"] = [times[subtask.frame] for subtask in listed]
    fields = list(kind.value_type)
    columns = [
        pa.array(known[field.name], field.type) if field.name in known else pa.nulls(len(listed), field.type)
        for field in fields
    ]
    rows = pa.StructArray.from_arrays(columns, fields=fields).take(np.tile(np.arange(len(listed)), len(times)))
    offsets = pa.array(np.arange(len(times) + 1, dtype=np.int32) * len(listed))
    return pa.ListArray.from_arrays(offsets, rows, type=kind)
