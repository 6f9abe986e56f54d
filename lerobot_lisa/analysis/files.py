"""How the analysis writes files: beside their place, and moved there when whole, so that a kill leaves no half."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pandas as pd


@contextmanager
def aside(path: Path) -> Iterator[Path]:
    """Where to write what is to be at `path`, in the same folder; it replaces what is there when the block ends."""
    partial = path.with_name(f"{path.name}.partial")
    yield partial
    partial.replace(path)


def write_json(content: Any, path: Path, **style: Any) -> None:
    """Write JSON values, with a newline at the end; `style` is `json.dumps`'s."""
    with aside(path) as partial:
        partial.write_text(json.dumps(content, **style) + "\n", encoding="utf-8")


def write_csv(table: pd.DataFrame, path: Path) -> None:
    """Write numbers with six digits; the same numbers give the same bytes on every system."""
    with aside(path) as partial:
        table.to_csv(partial, index=False, float_format="%.6g", lineterminator="\n")
