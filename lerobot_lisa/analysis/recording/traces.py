"""A trace: what a policy did at every step of an evaluation, and how each episode ended, as two small typed tables."""

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from lerobot_lisa.analysis.files import aside
from lerobot_lisa.errors import UserError

STEPS = pa.schema(
    {
        "group": pa.dictionary(pa.int32(), pa.string()),
        "task_id": pa.int32(),
        "episode": pa.int32(),
        "seed": pa.int64(),
        "step": pa.int32(),
        "instruction": pa.dictionary(pa.int32(), pa.string()),
        "code": pa.int32(),
        "observation": pa.uint64(),
        "action": pa.list_(pa.float32()),
        "success": pa.bool_(),
    }
)
"""One row for each step, up to the step that ended the episode. `code` is the skill code that the action followed, null
for a policy without; `observation` the hash of what the action was chosen on; `success` what came of it. `episode`
counts within the task."""

EPISODES = pa.schema(
    {
        "group": pa.dictionary(pa.int32(), pa.string()),
        "task_id": pa.int32(),
        "episode": pa.int32(),
        "seed": pa.int64(),
        "instruction": pa.dictionary(pa.int32(), pa.string()),
        "steps": pa.int32(),
        "success": pa.bool_(),
    }
)
"""One row for each episode; `success` as LeRobot's evaluation counts it."""

STEPS_FILE, EPISODES_FILE = "steps.parquet", "episodes.parquet"
KEY = ["group", "task_id", "episode"]
"""What names an episode."""

_ORIGIN = b"lerobot_lisa"
_CODE = {pa.int32(): pd.Int32Dtype()}  # only `code` may be null; the other integers go back below


@dataclass(frozen=True)
class Trace:
    """A recorded evaluation.

    Attributes:
        steps: Columns of `STEPS`.
        episodes: Columns of `EPISODES`.
        origin: How it came about: policy, environment, seeds (see `record.describe`), names of the skill codes.
    """

    steps: pd.DataFrame
    episodes: pd.DataFrame
    origin: Mapping[str, Any]

    @property
    def has_codes(self) -> bool:
        """Whether the policy has skill codes."""
        return bool(self.steps["code"].notna().any())

    @property
    def code_labels(self) -> list[str]:
        """What the K skill codes are called; numbers in traces that do not say it."""
        return self.origin.get("codes") or [str(code) for code in range(self.origin["policy"]["codebook_size"])]

    @property
    def question_stride(self) -> int:
        """Steps from one question to the skill predictor to the next: H, fewer with learned termination."""
        policy = self.origin["policy"]
        return int(policy.get("termination_stride") or policy["horizon"])

    @property
    def world(self) -> str | None:
        """`--env.type`."""
        return self.origin["env"].get("type")


def write(table: pa.Table, path: Path, origin: Mapping[str, Any]) -> None:
    """Write a table; its origin goes into the file's metadata."""
    with aside(path) as partial:
        pq.write_table(table.replace_schema_metadata({_ORIGIN: json.dumps(dict(origin))}), partial, compression="zstd")


def read(folder: Path) -> Trace:
    """Read the trace that an evaluation has left in a folder.

    Raises:
        UserError: There is none, it cannot be read, or it holds no step.
    """
    steps, origin = read_table(folder / STEPS_FILE, STEPS)
    episodes, _ = read_table(folder / EPISODES_FILE, EPISODES)
    if not steps.num_rows or not episodes.num_rows:
        raise UserError(f"{folder}: an empty trace, without a single step: record at least one episode")
    return Trace(_frame(steps), _frame(episodes), origin)


def read_table(path: Path, schema: pa.Schema) -> tuple[pa.Table, dict[str, Any]]:
    """A table that `write` wrote, and its origin.

    Raises:
        UserError: The file is missing or another.
    """
    try:
        table = pq.read_table(path)
        origin = json.loads((table.schema.metadata or {})[_ORIGIN])
        return table.select(schema.names).cast(schema), origin
    except FileNotFoundError as error:
        raise UserError(f"{path}: no trace there: record one with lisa-report") from error
    except (OSError, KeyError, ValueError, pa.ArrowException) as error:
        raise UserError(f"{path}: not a trace of lerobot_lisa ({str(error).splitlines()[0]})") from error


def concatenate(tables: Iterable[pa.Table], schema: pa.Schema) -> pa.Table:
    """One table of several, in the given order, with one dictionary of strings."""
    return pa.concat_tables([schema.empty_table(), *tables]).cast(schema).unify_dictionaries().combine_chunks()


def _frame(table: pa.Table) -> pd.DataFrame:
    frame = table.to_pandas()
    if "code" in frame:
        frame["code"] = table["code"].to_pandas(types_mapper=_CODE.get)
    return frame
