"""Which code this is: the commit of a checkout, and fingerprints of what a module uses of it."""

import ast
import hashlib
import json
import shlex
import subprocess
import sys
from collections.abc import Iterable, Iterator, Set
from functools import cache
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

PACKAGE = Path(__file__).parent
SAME_RESULTS = PACKAGE / "same_results.json"
_OURS = ("lerobot_lisa", "dataset_converters")


@cache
def commit() -> str:
    """Such as "69c8e5f", or "69c8e5f+changes" with changes that are not committed; of a wheel, its version."""
    installed = version("lerobot_policy_lisa")
    if not _git("ls-files", __file__):  # a wheel, maybe inside of somebody else's checkout
        return installed
    described = _git("rev-parse", "--short=7", "HEAD") or installed
    changed = _git("status", "--porcelain", "--untracked-files=no", "--", ":/*.py", ":/configs")
    return f"{described}+changes" if changed else described


def made() -> dict[str, str]:
    """How what this program writes is made: the commit of its code, and its command line."""
    program, *arguments = sys.argv
    return {"commit": commit(), "command": " ".join([Path(program).name, *map(shlex.quote, arguments)])}


def _git(*arguments: str) -> str:
    try:
        told = subprocess.run(["git", "-C", str(PACKAGE), *arguments], capture_output=True, text=True, check=False)
    except OSError:  # no git here
        return ""
    return told.stdout.strip()


def fingerprint(modules: Iterable[str], options: Set[str] = frozenset()) -> dict[str, str]:
    """What our code does that modules import, directly or not: for each folder some letters.

    Only another meaning changes them: comments, docstrings and layout do not, nor do files that are not imported, nor
    do changes that are declared to change no result (`same_results.json`).

    Args:
        modules: By their full names, such as "lerobot_lisa.policies.lisa.modeling_lisa".
        options: Those that are in use, such as "policy.termination_stride": a change may be declared unless one is.
    """
    folders: dict[str, list[str]] = {}
    for name, path in sorted(_closure(tuple(modules)).items()):
        package, inner, *_ = name.split(".")
        folder = inner if package == "lerobot_lisa" else package
        if what := _meaning(path, options):
            folders.setdefault(folder, []).append(f"{name} {what}")
    return {name: hashlib.sha256("\n".join(files).encode()).hexdigest()[:10] for name, files in folders.items()}


@cache
def _closure(modules: tuple[str, ...]) -> dict[str, Path]:
    """Modules and all of ours that they import, with their files."""
    found: dict[str, Path] = {}
    waiting = list(modules)
    while waiting:
        name = waiting.pop()
        path = _source(name)
        if path and name not in found:
            found[name] = path
            waiting += _imported(path)
    return found


@cache
def _source(name: str) -> Path | None:
    """The file of a module of ours; None: it is no module, or one of those that import all policies and worlds."""
    package, *inner = name.split(".")
    if package not in _OURS or not inner:
        return None
    root = PACKAGE if package == "lerobot_lisa" else Path(str(getattr(find_spec(package), "origin", ""))).parent
    candidates = (root.joinpath(*inner).with_suffix(".py"), root.joinpath(*inner, "__init__.py"))
    return next((path for path in candidates if path.is_file()), None)


@cache
def _imported(path: Path) -> tuple[str, ...]:
    return tuple(_imports(ast.parse(path.read_bytes())))


def _imports(tree: ast.AST) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)  # which may be modules


def _meaning(path: Path, options: Set[str] = frozenset()) -> str:
    """Of a file; where it is declared to make the same results as before, that of before: nothing, if it is new."""
    now = _own_meaning(path)
    while (change := _same_results().get(now)) and change.get("unless") not in options:
        now = change["was"]
    return now


@cache
def _own_meaning(path: Path) -> str:
    """Of a file, whatever is declared; apart from that, so that no set of options has it parsed again."""
    return meaning(path.read_bytes())


@cache
def _same_results() -> dict[str, dict[str, str]]:
    """Changes that change no result, by what files mean now (`python -m lerobot_lisa.reproduce.declare`)."""
    return {change["is"]: change for change in json.loads(SAME_RESULTS.read_text(encoding="utf-8"))}


def meaning(source: bytes) -> str:
    """Letters for Python code without comments, docstrings and layout."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list):
            node.body = [part for part in body if not _is_text(part)]  # type: ignore[attr-defined]
    return hashlib.sha256(ast.dump(tree).encode()).hexdigest()


def _is_text(node: object) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
