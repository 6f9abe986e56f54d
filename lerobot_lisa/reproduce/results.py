"""The tables of docs/results.md, made from committed files: one for each training and its evaluation."""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from scipy.stats import binomtest

from lerobot_lisa.analysis.files import aside, write_json
from lerobot_lisa.code_version import PACKAGE
from lerobot_lisa.errors import UserError
from lerobot_lisa.reproduce.outcomes import RUN, Outcome, State, is_of, read_published
from lerobot_lisa.reproduce.plan import Run
from lerobot_lisa.reproduce.rows import DATA_ONLY, Row, read_rows

FOLDER, PAGE = Path("docs/results"), Path("docs/results.md")
POLICIES = {
    "lisa": "LISA",
    "lang_dt": "Lang-DT",
    "babyai_rnn": "BabyAI's own network",
    "lang_bc": "LOReL's behaviour cloning",
    "lorel_planner": "LOReL's planner",
    "kmeans_skills": "k-means skills",
    DATA_ONLY: "no policy",
}
_HEAD = (
    "| row | steps at most | policy | success | heard, points | SPL | within 2 x | seeds x n | paper | commit |\n"
    "|---|---|---|---|---|---|---|---|---|---|"
)
_BLOCK = re.compile(r"(<!-- runs: (?P<name>\w+) -->\n).*?(<!-- end of runs -->)", re.DOTALL)
_LEVELS = ["GoToLocal", "GoToSeq", "SynthSeq", "BossLevel", "LOReL"]
_MAIN = ("ours", "table1", "table2")  # in the blocks of their worlds; other tables have blocks of their own
_Group = tuple[str, int, str]  # title of the row, limit of steps or 0, policy


def render_page(root: Path = PACKAGE.parent) -> None:
    """Write the page of a checkout anew.

    Raises:
        UserError: This is no checkout.
    """
    page = root / PAGE
    if not page.is_file():
        raise UserError(f"{page}: there is no page of results here: --render and --publish are for a checkout")
    with aside(page) as partial:
        partial.write_text(render(page.read_text(encoding="utf-8"), root / FOLDER), encoding="utf-8")


def render(page: str, folder: Path = FOLDER) -> str:
    """The page with its tables made anew."""
    rows = read_rows()
    return _BLOCK.sub(lambda found: f"{found[1]}{_block(found['name'], rows, folder)}\n{found[3]}", page)


def _block(name: str, rows: Mapping[str, Row], folder: Path) -> str:
    """A table of rows (`ablations`), or all of the paper's main tables and ours about a world (`babyai`)."""
    chosen = [row for row in rows.values() if row.table == name]
    chosen = chosen or [row for row in rows.values() if row.table in _MAIN and _world(row) == name]
    elsewhere = {row.title for row in rows.values()} - {row.title for row in chosen}
    runs = [kept for kept in read_published(folder) if kept["row"] not in elsewhere]
    titles = {row.title for row in chosen}
    return table([kept for kept in runs if kept["row"] in titles or kept["env"]["type"] == name], chosen)


def _world(row: Row) -> str:
    return row.data["make"].split()[0]


def table(runs: Iterable[Outcome], rows: Iterable[Row] = ()) -> str:
    """One line for each row, step limit and policy, seeds pooled or side by side; rows without runs are "not run"."""
    groups: dict[_Group, list[Outcome]] = {}
    listed = {row.title: row for row in rows}
    for row in listed.values():
        limit = row.evaluate.get("env.max_episode_steps") or 0
        groups |= {(row.title, limit, policy): [] for policy in row.policies}
    for run in runs:
        groups.setdefault((run["row"], run["env"]["max_episode_steps"] or 0, run["policy"]), []).append(run)
    lines = [_HEAD]
    places = {title: place for place, title in enumerate(listed)} if _in_order(listed.values()) else {}
    for key, group in sorted(groups.items(), key=lambda item: (places.get(item[0][0], 0), *_order(*item[0]))):
        lines.append(_line(key, group, listed.get(key[0])))
    lines += [line for row in listed.values() for line in _peers(row)]
    return "\n".join(lines)


def _in_order(rows: Iterable[Row]) -> bool:
    """Whether rows stay in the order of their files; those of the main tables go by level and size."""
    return not any(row.table in _MAIN for row in rows)


def _order(row: str, limit: int, policy: str) -> tuple[Any, ...]:
    level, _, size = row.partition(" ")
    kind, _, steps = policy.partition("@")
    place = [*POLICIES].index(kind) if kind in POLICIES else len(POLICIES)
    at = int(steps) if steps else 10**12
    return _LEVELS.index(level) if level in _LEVELS else len(_LEVELS), len(size), row, limit, place, kind, at


def _line(key: _Group, runs: Sequence[Outcome], row: Row | None) -> str:
    title, limit, policy = key
    at_most = limit or (f"{_own(row)}'s own" if row else "its own")
    paper = _paper(row.paper.get(policy) if row else None)
    cells = [title, at_most, _called(policy), *(_numbers(runs) if runs else ["not run", *[""] * 4]), paper]
    return f"| {' | '.join(str(cell) for cell in [*cells, _commits(runs)])} |"


def _called(policy: str) -> str:
    kind, _, steps = policy.partition("@")
    return POLICIES.get(kind, kind) + (f", {int(steps):,} steps" if steps else "")


def _own(row: Row) -> str:
    return {"babyai": "BabyAI", "lorel": "LOReL"}.get(_world(row), "its world")


def _numbers(runs: Sequence[Outcome]) -> Iterator[str]:
    rates = [run["rates"] for run in runs]
    successes, episodes = (sum(rate["success"][name] for rate in rates) for name in ("successes", "episodes"))
    interval = binomtest(successes, episodes).proportion_ci(method="wilson")
    yield f"**{100 * successes / episodes:.1f} %** ({100 * interval.low:.1f} to {100 * interval.high:.1f})"
    yield ", ".join(f"{rate['heard']['points']:.1f}" for rate in rates if rate.get("heard"))
    yield ", ".join(f"{rate['spl']['value']:.2f}" for rate in rates if rate.get("spl"))
    yield ", ".join(f"{rate['budgets']['2']['success']['percent']:.1f} %" for rate in rates if rate.get("budgets"))
    yield f"{len(runs)} x {rates[0]['success']['episodes']}"


def _paper(number: tuple[float, float] | None) -> str:
    if number is None:
        return ""
    return f"{number[0]:g} ± {number[1]:g} %" if number[1] else f"{number[0]:g} %"


def _commits(runs: Sequence[Outcome]) -> str:
    """Each commit leads to the file, which has the commands."""
    return ", ".join(f"[{run['commit']}](results/{run['file']})" for run in runs)


def _peers(row: Row) -> Iterator[str]:
    for name, number in row.peers.items():
        yield f"| {row.title} | | {name}, from their paper | {_paper(number)} |  |  |  |  |  |  |"


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
        path = folder / (outcome["env"]["type"] or _world(run.row)) / f"{run.row.name}_{run.policy}_seed{run.seed}.json"
        path.parent.mkdir(exist_ok=True)
        write_json(outcome, path, indent=2)
        written.append(path)
    return written


def shorten(command: str) -> str:
    """A command line without the folders of a machine."""
    return re.sub(r"(?<![\w.~-])/(?:[^\s/'\"]+/)+", ".../", command)
