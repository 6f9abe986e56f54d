"""What came out of runs: numbers with how they came about, in one file for each; fresh, stale or not there."""

import csv
import json
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from lerobot_lisa.analysis.files import write_json
from lerobot_lisa.analysis.training.logs import read_log
from lerobot_lisa.code_version import PACKAGE
from lerobot_lisa.errors import UserError
from lerobot_lisa.reproduce.perform import LOG
from lerobot_lisa.reproduce.plan import Run, Settings
from lerobot_lisa.reproduce.rows import find_configs
from lerobot_lisa.reproduce.steps import difference

Outcome = dict[str, Any]
PUBLISHED = PACKAGE.parent / "docs" / "results"  # of a checkout
RUN, STALE, STARTED, NOT_RUN, NO_RECIPE = "run", "stale", "started", "not run", "no recipe yet"


class State(NamedTuple):
    """Where a run stands.

    Attributes:
        word: One of the words above.
        outcome: What came out, of other settings or other code if stale; None: nothing yet.
        why: Why it is stale, or how far it is.
    """

    word: str
    outcome: Outcome | None = None
    why: str = ""


def state(run: Run, settings: Settings, published: Iterable[Outcome]) -> State:
    """Where a run stands, looking at its steps, then at what is kept of earlier ones, then at what is published."""
    if run.step is None:
        return State(NO_RECIPE)
    if run.step.note:
        return State(RUN, outcome(run, settings))
    candidates = [*filter(None, [_read(_path(run, settings))]), *(of for of in published if is_of(of, run))]
    for kept in candidates:
        if kept.get("depends") == run.step.depends:
            return State(RUN, kept)
    done = sum(step.note is not None for step in run.steps)
    begun = [step for step in run.steps[1:] if step.folder.exists()]
    if begun:
        return State(STARTED, None, f"{done} of {len(run.steps)} steps done")
    if candidates:
        before = candidates[0].get("depends")
        why = difference(before, run.step.depends) if before else "made before rows had files"
        return State(STALE, candidates[0], why)
    return State(NOT_RUN)


def keep(runs: Iterable[Run], settings: Settings) -> None:
    """Keep the outcome of every run that is done, so that it is known when settings or code have changed."""
    for run in runs:
        if run.step and run.step.note:
            path = _path(run, settings)
            if (_read(path) or {}).get("depends") != run.step.depends:
                path.parent.mkdir(parents=True, exist_ok=True)
                write_json(outcome(run, settings), path, indent=2)


def outcome(run: Run, settings: Settings) -> Outcome:
    """The numbers of a run that is done, and how they came about, without this machine's paths."""
    step = run.step
    assert step is not None
    notes = {each.kind: each.note or {} for each in run.steps}
    told = _told(step.folder / step.result)
    paths = {str(settings.root): "outputs/reproduce", str(find_configs()): "configs"}
    return {
        "name": run.row.name,
        "row": run.row.title,
        "policy": run.policy,
        "seed": run.seed,
        "commit": notes.get("train", notes[step.kind]).get("commit", ""),
        "note": run.row.note,
        **how_evaluated(told),
        "rates": told["rates"].get("overall", {}),
        "parts": {name: rates for name, rates in told["rates"].items() if name != "overall"},
        "commits": {kind: note.get("commit") for kind, note in notes.items()},
        "commands": {kind: _without(paths, note.get("command", "")) for kind, note in notes.items()},
        "seconds": {kind: note.get("seconds") for kind, note in notes.items()},
        "information": _information(run),
        "depends": step.depends,
    }


def _information(run: Run) -> list[tuple[int, float]]:
    """Bits between instructions and codes after so many steps of training; none where its log repeats some of them."""
    try:
        (train,) = (step for step in run.steps if step.kind == "train")
        read = read_log(train.folder / LOG)
    except (OSError, ValueError, UserError):  # not here, nothing trained or twice, or not from the first step on
        return []
    if read.steps[-1] > train.depends["config"]["steps"]:  # interrupted, and gone on with from before that
        return []
    counted = zip(read.steps, read.values.get("mutual_information", []), strict=False)
    return [(step, bits) for step, bits in counted if not math.isnan(bits)]


def how_evaluated(told: Mapping[str, Any]) -> Outcome:
    """Of what an evaluation has written: in which world, on which episodes, with which weights and versions."""
    origin = told.get("evaluation", {})
    return {
        "env": {name: origin.get("env", {}).get(name) for name in ("type", "task", "max_episode_steps")},
        "episodes": origin.get("n_episodes"),
        "evaluation_seed": origin.get("seed"),
        "batch_size": origin.get("batch_size"),
        "weights": origin.get("checkpoint", {}).get("sha256"),
        "versions": origin.get("versions", {}),
        "told": told.get("told"),
    }


def _told(result: Path) -> Mapping[str, Any]:
    """What an evaluation has written: `rates` of all episodes and of parts, and where they come from."""
    if result.suffix == ".json":
        return json.loads(result.read_text(encoding="utf-8"))
    if result.suffix == ".csv":
        with result.open(encoding="utf-8", newline="") as file:
            return {
                "rates": {line["part"]: {"success": _rate(line)} for line in csv.DictReader(file) if line["percent"]}
            }
    return {"rates": {}}


def _rate(line: Mapping[str, str]) -> dict[str, float]:
    whole = {name: int(float(line[name])) for name in ("successes", "episodes")}
    return {**whole, **{name: float(line[name]) for name in ("percent", "low", "high")}}


def read_published(folder: Path = PUBLISHED) -> list[Outcome]:
    """What is committed, each file a run, with the `file` that it is from, relative to the folder."""
    kept = [(path, _read(path)) for path in sorted(folder.glob("*/*.json"))]
    return [{**outcome, "file": path.relative_to(folder).as_posix()} for path, outcome in kept if outcome]


def is_of(kept: Outcome, run: Run) -> bool:
    """Whether what is kept is of a run; files that were made before rows had files know its title only."""
    if (kept.get("policy"), kept.get("seed")) != (run.policy, run.seed):
        return False
    if "name" in kept:
        return kept["name"] == run.row.name
    limit = run.row.evaluate.get("env.max_episode_steps")
    return (kept.get("row"), kept["env"]["max_episode_steps"]) == (run.row.title, limit)


def _path(run: Run, settings: Settings) -> Path:
    return settings.root / "results" / run.row.name / f"{run.policy}_seed{run.seed}.json"


def _read(path: Path) -> Outcome | None:
    try:
        kept = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return kept if isinstance(kept, dict) and "policy" in kept else None


def _without(paths: Mapping[str, str], command: str) -> str:
    for path, name in paths.items():
        command = command.replace(path, name)
    return command
