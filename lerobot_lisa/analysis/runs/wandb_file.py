"""Reads what `lerobot-train --wandb.enable=true --wandb.mode=offline` leaves: `wandb/offline-run-*/run-*.wandb`."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from lerobot_lisa.analysis.runs.run import CURVES, SETTINGS, Run
from lerobot_lisa.errors import UserError

_TRAIN = "train/"  # what LeRobot puts before the names of training metrics


def find_wandb_file(folder: Path) -> Path:
    """The one wandb file below a folder, such as a training's output folder.

    Raises:
        UserError: There is none, or there are several.
    """
    found = sorted(folder.rglob("run-*.wandb"))
    if len(found) != 1:
        raise UserError(f"{folder}: {len(found)} wandb files (run-*.wandb) below it: name one of them")
    return found[0]


def read_wandb(path: Path) -> Run:
    """Read a run; of one that goes on or was killed, what there is.

    Raises:
        UserError: The file cannot be read, or no training was logged in it.
    """
    settings: dict[str, Any] = {}
    rows: list[dict[str, float]] = []
    for record in _records(path):
        if record.HasField("run"):
            settings |= _settings({item.key: item.value_json for item in record.run.config.update})
        elif record.HasField("history"):
            logged = {item.key or ".".join(item.nested_key): item.value_json for item in record.history.item}
            if f"{_TRAIN}loss" in logged:
                rows.append({key: float(value) for key, value in logged.items() if key.startswith((_TRAIN, "_step"))})
    if not rows:
        raise UserError(f"{path}: no training metrics in it: give a run of lerobot-train")
    values = {key: [row[_TRAIN + key] for row in rows] for key in CURVES if all(_TRAIN + key in row for row in rows)}
    return Run(path.parent.name, [int(row["_step"]) for row in rows], values, settings)


def _records(path: Path) -> Iterator[Any]:
    from wandb.proto.wandb_internal_pb2 import Record
    from wandb.sdk.internal.datastore import DataStore

    store = DataStore()
    try:
        store.open_for_scan(str(path))
    except Exception as error:  # wandb raises just that for another file
        raise UserError(f"{path}: not a wandb file ({error})") from error
    while data := _next(store):
        record = Record()
        record.ParseFromString(data)
        yield record


def _next(store: Any) -> bytes | None:
    """The next record; None at the end, also where the file breaks off."""
    try:
        return store.scan_data()
    except AssertionError:
        return None


def _settings(config: dict[str, str]) -> dict[str, Any]:
    policy, seed = json.loads(config.get("policy", "{}")), json.loads(config.get("seed", "null"))
    known = {**(policy or {}), "seed": seed}
    return {name: str(known[key]) for name, key in SETTINGS.items() if known.get(key) is not None}
