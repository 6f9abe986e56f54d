"""A checkpoint's files, from a folder or the Hub: only those that lie in it, of bounded size."""

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lerobot_lisa.errors import UserError

CONFIG, WEIGHTS = "config.json", "model.safetensors"

_MB = 2**20
_LIMITS = {CONFIG: 2 * _MB, WEIGHTS: 32 * 1024 * _MB, ".json": 2 * _MB, ".safetensors": 64 * _MB}  # the rest: states
_DEEPEST = 20  # JSON in JSON; ours needs 5
RETAKE = "take the checkpoint again from where it was trained"


@contextmanager
def refusing(what: str, fix: str = RETAKE) -> Iterator[None]:
    """Turn whatever a library says about a file it cannot take into one line.

    Every exception, because libraries raise every kind of them at files made to break them.

    Args:
        what: File, and what cannot be done with it.
        fix: What to do about it.
    """
    try:
        yield
    except UserError:
        raise
    except Exception as error:
        raise UserError(f"{what} ({_reason(error)}): {fix}") from error


def _reason(error: BaseException) -> str:
    """The first line of an error, and of what was first of its causes."""
    first = error
    while first.__cause__ is not None:
        first = first.__cause__
    lines = [(str(one).strip().splitlines() or [type(one).__name__])[0][:150] for one in (error, first)]
    return "; ".join(dict.fromkeys(lines))


@dataclass(frozen=True)
class Files:
    """A checkpoint as a set of files.

    Attributes:
        name: Folder or Hub id, as the user has it.
        folder: Where the files are.
        revision: Commit of the Hub's repository; None for a folder.
    """

    name: str
    folder: Path
    revision: str | None = None

    def path(self, name: str) -> Path:
        """Where a file is; one of the Hub is fetched first.

        Raises:
            UserError: It is missing, lies outside the checkpoint, is no regular file or too big.
        """
        if Path(name).name != name or Path(name).suffix not in _LIMITS:
            raise UserError(f"{self.name} names the file {name!r:.200}: only .json and .safetensors beside it are read")
        limit = _LIMITS.get(name, _LIMITS[Path(name).suffix])
        if self.revision is not None:
            _fetch(self.name, name, self.revision, limit)
        path = self.folder / name
        with refusing(f"{path} cannot be read", "correct its permissions"):
            self._check(path, limit)
        return path

    def _check(self, path: Path, limit: int) -> None:
        if not path.is_file():
            raise UserError(f"{path} is missing or no regular file: {RETAKE}")
        places = [self.folder.resolve()]
        if places[0].parent.name == "snapshots":  # the Hub's cache: files are links to blobs
            places.append(places[0].parents[1] / "blobs")
        if not any(path.resolve().is_relative_to(place) for place in places):
            raise UserError(f"{path} is a link that leaves the checkpoint: put the file itself there")
        with path.open("rb") as file:
            if (size := os.fstat(file.fileno()).st_size) > limit:
                raise UserError(f"{path} has {size:,} bytes, more than {limit:,}: {RETAKE}")

    def json(self, name: str) -> dict[str, Any]:
        """An object from a JSON file.

        Raises:
            UserError: There is no such file, or it holds something else.
        """
        path = self.path(name)
        with refusing(f"{path} is not JSON as checkpoints have it"):
            found = json.loads(path.read_text(encoding="utf-8"), parse_constant=_no_number)
            if not isinstance(found, dict) or _depth(found) > _DEEPEST:
                raise ValueError(f"no object, or nested more than {_DEEPEST} deep")
        return found


def find(name: str, revision: str | None = None) -> Files:
    """A checkpoint's files, by folder or Hub id; `revision` is a branch, tag or commit of the Hub's repository.

    Raises:
        UserError: There is no checkpoint.
    """
    if Path(name).is_dir():
        folder = Path(name)
        if not (folder / CONFIG).exists():
            raise UserError(f"--policy.path={name}: no checkpoint (a folder with {CONFIG}) there")
        return Files(name, folder)
    from huggingface_hub import hf_hub_download
    from huggingface_hub.errors import HfHubHTTPError

    try:
        found = hf_hub_download(name, CONFIG, revision=revision, dry_run=True)
    except (OSError, ValueError, HfHubHTTPError) as error:
        at = f" at revision {revision}" if revision else ""
        raise UserError(
            f"--policy.path={name}: no checkpoint (a folder with {CONFIG}) there, nor a repository of the Hub{at} that "
            "can be reached: correct the path"
        ) from error
    return Files(name, Path(found.local_path).parent, found.commit_hash)


def _fetch(repo: str, name: str, revision: str, limit: int) -> None:
    """Have a file in the Hub's cache, unless it is too big to be worth it."""
    from huggingface_hub import hf_hub_download

    with refusing(f"{repo} of the Hub, revision {revision}: {name} cannot be fetched"):
        found = hf_hub_download(repo, name, revision=revision, dry_run=True)
        if (found.file_size or 0) > limit:
            raise UserError(f"{repo} of the Hub: {name} has {found.file_size:,} bytes, more than {limit:,}: {RETAKE}")
        hf_hub_download(repo, name, revision=revision)


def _no_number(constant: str) -> None:
    raise ValueError(f"{constant} is no number")


def _depth(value: Any) -> int:
    inside = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return 1 + max(map(_depth, inside), default=0)
