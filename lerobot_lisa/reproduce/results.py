"""The tables of docs/results.md, made from committed files: one for each training and its evaluation."""

import re
from collections.abc import Iterable, Mapping
from pathlib import Path

from lerobot_lisa.analysis.files import aside, write_json
from lerobot_lisa.code_version import PACKAGE
from lerobot_lisa.errors import UserError
from lerobot_lisa.reproduce.before import read_before
from lerobot_lisa.reproduce.by_part import by_part
from lerobot_lisa.reproduce.figures import draw_all, link
from lerobot_lisa.reproduce.outcomes import RUN, State, is_of, read_published
from lerobot_lisa.reproduce.plan import Run
from lerobot_lisa.reproduce.rows import MAIN, Row, read_rows
from lerobot_lisa.reproduce.side_by_side import side_by_side
from lerobot_lisa.reproduce.tables import by_policy
from lerobot_lisa.reproduce.unseen_words import unseen_words

FOLDER, PAGE = Path("docs/results"), Path("docs/results.md")
_BLOCK = re.compile(r"(<!-- (?P<kind>runs|figure): (?P<name>\w+) -->\n).*?(<!-- end of (?P=kind) -->)", re.DOTALL)
_SPECIAL = {"parts": by_part, "unseen": unseen_words}
_PAIRED = ("lorel", "metaworld")  # worlds whose tables have LISA and Lang-DT side by side


def render_page(root: Path = PACKAGE.parent) -> None:
    """Write the page of a checkout anew, and draw its figures.

    Raises:
        UserError: This is no checkout.
    """
    page = root / PAGE
    if not page.is_file():
        raise UserError(f"{page}: there is no page of results here: --render and --publish are for a checkout")
    with aside(page) as partial:
        partial.write_text(render(page.read_text(encoding="utf-8"), root / FOLDER), encoding="utf-8")
    draw_all(read_published(root / FOLDER), list(read_rows().values()), page.parent)


def render(page: str, folder: Path = FOLDER) -> str:
    """The page with its tables made anew."""
    rows = read_rows()

    def block(found: re.Match[str]) -> str:
        if found["kind"] == "figure":
            return f"{found[1]}{link(found['name'], read_published(folder), rows.values())}\n{found[4]}"
        return f"{found[1]}{_block(found['name'], rows, folder)}\n{found[4]}"

    return _BLOCK.sub(block, page)


def _block(name: str, rows: Mapping[str, Row], folder: Path) -> str:
    """A table of rows (`ablations`), all of the main tables and ours about a world (`babyai`), or a special one."""
    if name in _SPECIAL:
        return _SPECIAL[name](read_published(folder), rows.values())
    chosen = [row for row in rows.values() if row.table == name and not row.parts]
    chosen = chosen or [row for row in rows.values() if row.table in MAIN and row.family == name]
    elsewhere = {row.title for row in rows.values()} - {row.title for row in chosen}
    runs = [kept for kept in read_published(folder) if kept["row"] not in elsewhere]
    if name in _PAIRED:
        return side_by_side(runs, sorted(chosen, key=_seen_first), read_before(name, folder))
    titles = {row.title for row in chosen}
    return by_policy([kept for kept in runs if kept["row"] in titles or kept["env"]["type"] == name], chosen)


def _seen_first(row: Row) -> tuple[bool, int]:
    """States before images; what training knows before what it does not."""
    suites = ["seen", "compositions", "rephrasals", row.evaluate.get("env.task")]
    return row.pictures, suites.index(row.evaluate.get("env.task"))


def publish(states: Iterable[tuple[Run, State]], root: Path = PACKAGE.parent) -> list[Path]:
    """Keep what came out of runs among the committed files, in the place of what was there of the same runs.

    Raises:
        UserError: This is no checkout, nothing has been run, or it was run with code that nobody else has.
    """
    written, folder = [], root / FOLDER
    if not folder.is_dir():
        raise UserError(f"{folder}: there is no such folder here: --render and --publish are for a checkout")
    fresh = [(run, at.outcome) for run, at in states if at.word == RUN and at.outcome and "file" not in at.outcome]
    if not fresh:
        raise UserError("none of these rows has been run here with the code that is here: run them first")
    for run, outcome in fresh:
        if private := [kind for kind, commit in outcome["commits"].items() if "+" in str(commit)]:
            raise UserError(
                f"{run.row.name} {run.policy} seed {run.seed}: {private[0]} was made with changes that are not "
                "committed, so nobody could make it again: commit them, and run it anew"
            )
    for run, outcome in fresh:
        for kept in read_published(folder):
            if is_of(kept, run):
                (folder / kept["file"]).unlink()
        path = folder / (outcome["env"]["type"] or run.row.family) / f"{run.row.name}_{run.policy}_seed{run.seed}.json"
        path.parent.mkdir(exist_ok=True)
        write_json(outcome, path, indent=2)
        written.append(path)
    return written


def shorten(command: str) -> str:
    """A command line without the folders of a machine."""
    return re.sub(r"(?<![\w.~-])/(?:[^\s/'\"]+/)+", ".../", command)
