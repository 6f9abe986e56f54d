"""Rows of the benchmark table: how they are printed, kept as JSON, and compared with those of another commit."""

import json
import os
import platform
import subprocess
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

from benchmarks.measuring import Contest, middle
from lerobot_lisa.errors import UserError


@dataclass(frozen=True)
class Aim:
    """What a row's figure should be: at least or at most a number."""

    kind: Literal["at least", "at most"]
    number: float
    unit: str = "x"

    def met(self, value: float) -> bool:
        """Whether a figure is good enough."""
        return value >= self.number if self.kind == "at least" else value <= self.number

    def __str__(self) -> str:
        return f"{'>=' if self.kind == 'at least' else '<='} {self.number:g}{self.unit and ' ' + self.unit}"


@dataclass(frozen=True)
class Row:
    """One line of the table.

    Attributes:
        what: What is measured.
        against: The named alternative; empty for a share.
        aim: What `cpu` should be.
        cpu: The figure from processor time.
        wall: The same from the clock.
        ours: Our rate or time, in words with its unit.
        theirs: The alternative's.
        details: Further numbers, kept in the JSON and printed below the row.
    """

    what: str
    against: str
    aim: Aim
    cpu: float
    wall: float
    ours: str = ""
    theirs: str = ""
    details: dict[str, Any] = field(default_factory=dict)


def ratio_row(what: str, against: str, aim: float, result: Contest, things: str, **details: Any) -> Row:
    """Row of a contest, with both sides' median rates of `things` per CPU-second."""
    ours, theirs = (1 / middle(times).cpu for times in (result.ours, result.alternative))
    return Row(
        what,
        against,
        Aim("at least", aim),
        result.cpu_ratio,
        result.wall_ratio,
        f"{ours:,.4g} {things}/CPU-s",
        f"{theirs:,.4g} {things}/CPU-s",
        {"repeats": len(result.ours), **details},
    )


def as_markdown(rows: Sequence[Row]) -> str:
    """The table, as it stands in docs/performance.md."""
    lines = [
        "| what | alternative in the same run | aim | CPU | wall | ours | the alternative's |",
        "|---|" + "---|" * 6,
    ]
    for row in rows:
        unit = row.aim.unit
        missed = "" if row.aim.met(row.cpu) else " (missed)"
        cells = [row.what, row.against or "-", str(row.aim), f"{_figure(row.cpu)} {unit}{missed}"]
        lines.append("| " + " | ".join([*cells, f"{_figure(row.wall)} {unit}", row.ours, row.theirs]) + " |")
    return "\n".join(lines)


def details(rows: Sequence[Row]) -> str:
    """What the table has no column for, one line for each row."""
    lines = []
    for row in rows:
        known = [f"{key} {_figure(v) if isinstance(v, float) else v}" for key, v in row.details.items()]
        lines.append(f"{row.what}: {', '.join(known)}")
    return "\n".join(lines)


def _figure(value: float) -> str:
    return f"{value:,.3g}" if abs(value) < 1000 else f"{value:,.0f}"


def save(rows: Sequence[Row], path: Path) -> None:
    """Write the rows and where they were measured."""
    document = {**_circumstances(), "rows": [asdict(row) for row in rows]}
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(document, indent=2) + "\n")


def _circumstances() -> dict[str, Any]:
    import torch

    return {
        "commit": _git("rev-parse", "--short", "HEAD"),
        "changed_files": _git("status", "--porcelain", "--untracked-files=no").splitlines(),
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "processor": _processor(),
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "load": os.getloadavg()[0],
        "threads": torch.get_num_threads(),
        "python": platform.python_version(),
        "torch": torch.__version__,
    }


def _git(*arguments: str) -> str:
    found = subprocess.run(["git", *arguments], cwd=Path(__file__).parent, capture_output=True, text=True, check=False)
    return found.stdout.rstrip()


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), "unknown")


def load(path: Path) -> list[Row]:
    """Rows that `save` has written."""
    return [Row(**{**row, "aim": Aim(**row["aim"])}) for row in _document(path)["rows"]]


def _document(path: Path) -> dict[str, Any]:
    try:
        document = json.loads(path.read_text())
        if {"commit", "rows"} <= document.keys():
            return document
        problem = "it has no rows"
    except (OSError, ValueError, AttributeError) as error:
        problem = str(error)
    raise UserError(f"{path} is not a file that --json has written ({problem})")


def comparison(rows: Sequence[Row], paths: Sequence[Path]) -> str:
    """How the CPU figures have changed since earlier runs that were kept in `paths`."""
    before = {row.what: row.cpu for path in paths for row in load(path)}
    commits = sorted({_document(path)["commit"] or "earlier" for path in paths})
    lines = [f"| what | {', '.join(commits)} | now | change |", "|---|---|---|---|"]
    for row in rows:
        then = before.get(row.what)
        old, change = ("-", "new") if then is None else (_figure(then), f"{100 * (row.cpu / then - 1):+.0f} %")
        lines.append(f"| {row.what} | {old} | {_figure(row.cpu)} | {change} |")
    return "\n".join(lines)
