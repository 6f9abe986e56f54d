"""The rows of the paper's tables, and ours beside them: files of `configs/rows`, each the difference to another row."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields
from difflib import get_close_matches
from pathlib import Path
from typing import Any, get_args, get_origin

import yaml

from lerobot_lisa.code_version import PACKAGE
from lerobot_lisa.errors import UserError

_DIGITS = re.compile(r"(\d+)")
MAIN = ("ours", "table1", "table2")  # tables that are shown by worlds; others have a table of their own
DATA_ONLY = "dataset"  # the "policy" of a row that asks a dataset and trains nothing


@dataclass(frozen=True)
class Row:
    """One row of a table: data, policies to train on it, and how they are evaluated.

    Attributes:
        name: Table and row, such as "table1.gotoseq_1k".
        title: For people, such as "GoToSeq 1k".
        data: Which demonstrations: `make`, words of a `dataset_converters` command; the rest are its options.
        recipes: Folder of `configs` that has a file for each policy, which `lerobot-train --config_path` reads.
        policies: What is trained; `DATA_ONLY` where nothing is.
        options: What differs from the recipe, by policy or under "all": options of `lerobot-train`.
        curve: Steps of the training after which its policy is evaluated besides, for a learning curve.
        start: Name of a row whose policy of the same kind and seed training starts from; empty: from nothing.
        evaluate: `program` (default: `lisa-diagnose heard`) and how many `tasks` it runs (default: 1), for estimates;
            the rest are its options.
        evaluate_by_policy: What differs from that, by policy.
        seeds: Of the trainings that are published.
        paper: Number of the paper in percent, and what it says behind +- (0 where it says nothing), by policy.
        parts: Numbers of the paper for parts of the evaluation, such as tasks: by part, then by policy.
        peers: The same from other papers, by their names.
        random: What uniformly random actions achieve in the evaluation, in percent; None: not measured.
        source: Of the paper's numbers: table or section.
        note: What a reader should know.
    """

    name: str
    title: str
    data: Mapping[str, Any]
    evaluate: Mapping[str, Any]
    recipes: str = ""
    policies: tuple[str, ...] = ("lisa", "lang_dt")
    options: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    curve: tuple[int, ...] = ()
    start: str = ""
    evaluate_by_policy: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    seeds: tuple[int, ...] = (0, 1)
    paper: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    parts: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    peers: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    random: float | None = None
    source: str = ""
    note: str = ""

    @property
    def table(self) -> str:
        """The part of the name before the point."""
        return self.name.partition(".")[0]

    @property
    def family(self) -> str:
        """The package of `dataset_converters` that makes its data: `babyai`, `lorel`, `metaworld`."""
        return self.data["make"].split()[0]

    @property
    def world(self) -> str:
        """What decides how long things take: a BabyAI level, Meta-World's tasks, or LOReL with states or images."""
        tasks = self.data.get("tasks", "LOReL")
        several = "Meta-World" if "," in tasks else tasks
        return self.data.get("level") or f"{several} {'images' if self.pictures else 'states'}"

    @property
    def pictures(self) -> bool:
        """Whether its demonstrations show pictures, however their converter is told so."""
        return bool(self.data.get("images") or self.data.get("image_size"))

    def differences(self, policy: str) -> dict[str, Any]:
        """Options of `lerobot-train` in which a policy's training differs from its recipe."""
        return {**self.options.get("all", {}), **self.options.get(policy, {})}

    def evaluation(self, policy: str) -> dict[str, Any]:
        """How a policy is evaluated: `program`, `tasks`, and the program's options."""
        return {**self.evaluate, **self.evaluate_by_policy.get(policy, {})}


def find_configs() -> Path:
    """The folder of recipes: packed into a wheel, beside the package in a checkout."""
    return next(folder for folder in (PACKAGE / "configs", PACKAGE.parent / "configs") if folder.is_dir())


def read_rows(own: Path | None = None) -> dict[str, Row]:
    """Every row by its name, in the order of tables and sizes.

    Args:
        own: A folder of the user's own rows, `<table>/<row>.yaml`, which may be `like` those of the project.

    Raises:
        UserError: A row cannot be read, or there is none in the folder.
    """
    files = _Files([*([own] if own else []), find_configs() / "rows"])
    if own and not any(own.glob("*/*.yaml")):
        raise UserError(f"--rows={own}: there is no row in it, a file <table>/<row>.yaml")
    return {name: files.row(name) for name in files.names()}


def choose(names: list[str], rows: Mapping[str, Row]) -> list[Row]:
    """Rows by their names, tables by theirs.

    Raises:
        UserError: There is no such row or table.
    """
    chosen: dict[str, Row] = {}
    for name in names:
        found = {row.name: row for row in rows.values() if name in (row.name, row.table)}
        if not found:
            raise UserError(f"there is no row or table {name!r:.60}: {_near(name, rows)} (all: lisa-reproduce --list)")
        chosen |= found
    return list(chosen.values())


def _near(name: str, rows: Mapping[str, Row]) -> str:
    known = [*rows, *dict.fromkeys(row.table for row in rows.values())]
    by_end = [row for row in rows if row.partition(".")[2] == name.rpartition(".")[2]]
    near = dict.fromkeys([*by_end, *get_close_matches(name, known, n=3, cutoff=0.4)])
    return f"do you mean {' or '.join([*near][:4])}?" if near else "nothing is called nearly so"


class _Files:
    """The files of rows: of several folders, the first that has a row's file decides."""

    def __init__(self, folders: list[Path]) -> None:
        self.folders = folders

    def names(self) -> list[str]:
        """Of all rows."""
        paths = {f"{path.parent.name}.{path.stem}" for folder in self.folders for path in folder.glob("*/*.yaml")}
        return sorted(paths, key=lambda name: [int(part) if part.isdigit() else part for part in _DIGITS.split(name)])

    def row(self, name: str) -> Row:
        """A row as its file, and the files that this is `like`, have it."""
        settings = self._settings(name, ())
        try:
            return Row(name=name, **_typed(settings))
        except (TypeError, ValueError) as error:
            raise UserError(f"{self._path(name)}: {error}") from error

    def _settings(self, name: str, seen: tuple[str, ...]) -> dict[str, Any]:
        path = self._path(name)
        try:
            own = yaml.safe_load(path.read_text(encoding="utf-8"))
        except (OSError, yaml.YAMLError) as error:
            raise UserError(f"{path}: {' '.join(str(error).split())}") from error
        if not isinstance(own, dict):
            raise UserError(f"{path}: a row is settings with names, see the other files beside it")
        like = own.pop("like", None)
        if like is None:
            return own
        if like in (name, *seen):
            raise UserError(f"{path}: `like: {like}` goes round in circles")
        base = self._settings(str(like), (name, *seen))
        for of_one_row in ("paper", "parts", "peers", "source", "note"):
            base.pop(of_one_row, None)
        return _merged(base, own)

    def _path(self, name: str) -> Path:
        table, _, row = name.partition(".")
        paths = [folder / table / f"{row}.yaml" for folder in self.folders]
        return next((path for path in paths if path.is_file()), paths[-1])


def _merged(base: Mapping[str, Any], own: Mapping[str, Any]) -> dict[str, Any]:
    merged = dict(base)
    for key, value in own.items():
        both = isinstance(value, dict) and isinstance(merged.get(key), dict)
        merged[key] = _merged(merged[key], value) if both else value
    return merged


def _typed(settings: Mapping[str, Any]) -> dict[str, Any]:
    known = {part.name for part in fields(Row)}
    if unknown := sorted(set(settings) - known):
        raise ValueError(f"`{unknown[0]}` is no setting of a row: choose from {', '.join(sorted(known))}")
    for part in fields(Row):
        if part.name in settings:
            _check_settings(part.name, settings[part.name], part.type)
    typed = dict(settings)
    for key in ("policies", "seeds", "curve"):
        if key in typed:
            typed[key] = tuple(typed[key])
    for key in ("paper", "peers"):
        typed[key] = dict(_numbers(settings.get(key, {})))
    return typed


def _check_settings(name: str, value: Any, kind: Any) -> None:
    """Where a row has settings with names, and settings within them, the file has them, too."""
    if get_origin(kind) is not Mapping:
        return
    if not isinstance(value, dict):
        raise ValueError(f"`{name}` holds settings with names, not {value!r:.40}")
    for key, inner in value.items():
        _check_settings(f"{name}: {key}", inner, get_args(kind)[1])


def _numbers(listed: Mapping[str, Any]) -> Iterator[tuple[str, tuple[float, float]]]:
    for name, value in listed.items():
        number, spread = value if isinstance(value, list) else (value, 0)
        yield name, (float(number), float(spread))
