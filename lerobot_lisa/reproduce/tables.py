"""The table of BabyAI, ablations and transfer: one line for each row and policy, what was not run included."""

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from lerobot_lisa.reproduce import cells
from lerobot_lisa.reproduce.outcomes import Outcome
from lerobot_lisa.reproduce.rows import MAIN, Row

_HEAD = [
    "row", "steps at most", "policy", "success", "heard, points", "SPL", "within 2 x", "seeds x n", "paper", "commit"
]  # fmt: skip
_LEVELS = ["GoToLocal", "GoToSeq", "SynthSeq", "BossLevel", "LOReL"]
_Group = tuple[str, int, str]  # title of the row, limit of steps or 0, policy


def by_policy(runs: Iterable[Outcome], rows: Iterable[Row] = ()) -> str:
    """One line for each row, step limit and policy, seeds pooled or side by side; rows without runs are "not run"."""
    groups: dict[_Group, list[Outcome]] = {}
    listed = {row.title: row for row in rows}
    for row in listed.values():
        limit = row.evaluate.get("env.max_episode_steps") or 0
        groups |= {(row.title, limit, policy): [] for policy in row.policies}
    for run in runs:
        groups.setdefault((run["row"], run["env"]["max_episode_steps"] or 0, run["policy"]), []).append(run)
    places = {title: number for number, title in enumerate(listed)} if _in_order(listed.values()) else {}
    ordered = sorted(groups.items(), key=lambda item: (places.get(item[0][0], 0), *place(*item[0])))
    lines = [_line(key, group, listed.get(key[0])) for key, group in ordered]
    return cells.markdown(_HEAD, [*lines, *(line for row in listed.values() for line in _peers(row))])


def _in_order(rows: Iterable[Row]) -> bool:
    """Whether rows stay in the order of their files; those of the main tables go by level and size."""
    return not any(row.table in MAIN for row in rows)


def place(row: str, limit: int, policy: str) -> tuple[Any, ...]:
    """By which lines are sorted: level, size, limit of steps, policy, step."""
    level, _, size = row.partition(" ")
    kind, _, steps = policy.partition("@")
    which = [*cells.NAMES].index(kind) if kind in cells.NAMES else len(cells.NAMES)
    at = int(steps) if steps else 10**12
    return _LEVELS.index(level) if level in _LEVELS else len(_LEVELS), len(size), row, limit, which, kind, at


def _line(key: _Group, runs: Sequence[Outcome], row: Row | None) -> Iterator[object]:
    title, limit, policy = key
    yield from (title, limit or cells.own_limit(row), cells.called(policy))
    yield from _numbers(runs) if runs else (cells.NOT_RUN, *[""] * 4)
    yield from (cells.paper(row.paper.get(policy) if row else None), cells.commits(runs))


def _numbers(runs: Sequence[Outcome]) -> Iterator[str]:
    rates = [run["rates"] for run in runs]
    yield cells.success(runs)
    yield cells.heard(runs)
    yield ", ".join(f"{rate['spl']['value']:.2f}" for rate in rates if rate.get("spl"))
    yield ", ".join(f"{rate['budgets']['2']['success']['percent']:.1f} %" for rate in rates if rate.get("budgets"))
    yield cells.times(runs)


def _peers(row: Row) -> Iterator[list[str]]:
    for name, number in row.peers.items():
        yield [row.title, "", f"{name}, from their paper", cells.paper(number), *[""] * 6]
