"""A step: one command of LeRobot's or ours, the folder of what it makes, and the note of how that was made."""

import hashlib
import json
import shlex
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from lerobot_lisa.analysis.files import write_json

NOTE = "step.json"


@dataclass(frozen=True)
class Step:
    """One command; what it makes lies in a folder that is named after all that it depends on.

    So a result is found again only where nothing has changed, and results of other settings or of other code stay where
    they are. doit has a database for this; a note beside the result can also be read by people, by jobs of a cluster at
    the same time, and by whoever gets the folder.

    Attributes:
        kind: What the step does: "data", "train", or the program that evaluates.
        label: Whose step it is, for people.
        parent: Folder of all steps of the kind.
        depends: All that the result depends on, JSON values.
        template: The command; "{folder}" stands for the step's own folder.
        result: The file that the command writes last, relative to the folder.
        after: Steps whose results are needed.
        seconds: How long it takes on two cores, estimated.
        going_on: A file, relative to the folder: where it is, `lerobot-train` goes on from it.
    """

    kind: str
    label: str
    parent: Path
    depends: Mapping[str, Any]
    template: tuple[str, ...]
    result: str
    after: tuple["Step", ...] = ()
    seconds: float = 0.0
    going_on: str = ""

    @cached_property
    def key(self) -> str:
        """A few letters for all that the result depends on."""
        return hashlib.sha256(json.dumps(self.depends, sort_keys=True).encode()).hexdigest()[:12]

    @property
    def name(self) -> str:
        """Tells it from every other step."""
        return f"{self.kind}/{self.key}"

    @property
    def folder(self) -> Path:
        """Where everything of the step lies."""
        return self.parent / self.key

    @property
    def command(self) -> list[str]:
        """From the beginning."""
        return [word.replace("{folder}", str(self.folder)) for word in self.template]

    @property
    def next_command(self) -> list[str]:
        """The command, or LeRobot's to go on with an interrupted training."""
        if self.going_on and (self.folder / self.going_on).is_file():
            return ["lerobot-train", f"--config_path={self.folder / self.going_on}", "--resume=true"]
        return self.command

    @property
    def note(self) -> dict[str, Any] | None:
        """How the result was made; None: it is not there."""
        return read_note(self.folder / NOTE) if (self.folder / self.result).exists() else None

    def write_note(self, commit: str, seconds: float) -> None:
        """Say how the result was made: after this, the step is done."""
        made = {"label": self.label, "command": shlex.join(self.command), "commit": commit, "seconds": round(seconds)}
        write_json({**made, "depends": self.depends}, self.folder / NOTE, indent=2)

    def chain(self) -> Iterator["Step"]:
        """All steps that it needs, and itself, in order."""
        for step in self.after:
            yield from step.chain()
        yield self


def read_note(path: Path) -> dict[str, Any] | None:
    """A note; None: there is none, or it is none of ours."""
    try:
        note = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return note if isinstance(note, dict) and "depends" in note else None


def difference(before: Mapping[str, Any], now: Mapping[str, Any], most: int = 3) -> str:
    """In what two results' `depends` differ, in a few words: "config.steps 2000 -> 1000, code of networks"."""
    differing = dict.fromkeys(_differing(before, now))
    code = [name.rpartition(".")[2] for name in differing if ".code." in f".{name}"]
    said = [name for name in differing if ".code." not in f".{name}"]
    said = said[:most] + ([f"{len(said) - most} settings more"] if len(said) > most else [])
    return ", ".join([*said, *([f"code of {' and '.join(dict.fromkeys(code))}"] if code else [])])


def _differing(before: Any, now: Any, name: str = "") -> Iterator[str]:
    if isinstance(before, Mapping) and isinstance(now, Mapping):
        for key in dict.fromkeys([*before, *now]):
            inner = name if key == "of" else f"{name}.{key}".lstrip(".")  # an evaluation's policy speaks for itself
            yield from _differing(before.get(key), now.get(key), inner)
    elif before != now:
        shown = f"{before} -> {now}"
        yield name if ".code." in f".{name}" or len(shown) > 40 else f"{name} {shown}"
