"""The tables of LOReL and Meta-World: one line for each row, LISA beside Lang-DT; what was measured before below."""

from collections.abc import Iterable, Iterator, Sequence

from lerobot_lisa.reproduce import cells
from lerobot_lisa.reproduce.outcomes import Outcome
from lerobot_lisa.reproduce.rows import Row

_HEAD = [
    "row", "LISA", "Lang-DT", "the original", "heard, points", "seeds x n", "paper", "random actions", "commit"
]  # fmt: skip
_PAIR = ("lisa", "lang_dt")


def side_by_side(runs: Sequence[Outcome], rows: Iterable[Row], before: Sequence[Outcome] = ()) -> str:
    """One line for each row.

    Args:
        runs: Published; where a cell is of several policies, theirs stand in the order of the columns.
        rows: Of the table, in their order.
        before: What was measured before rows had files; each names the row that it is `like`.
    """
    listed = {row.name: row for row in rows}
    lines: list[Iterable[str]] = []
    for row in listed.values():
        own = [run for run in runs if run["row"] == row.title]
        lines.append(_line(row.title, row, own, [policy for policy in row.policies if policy not in _PAIR]))
        for name, number in row.peers.items():
            lines.append([f"{row.title}: {name}, from their paper", *[""] * 5, cells.paper(number), "", ""])
    for title in dict.fromkeys(run["row"] for run in before):
        kept = [run for run in before if run["row"] == title]
        lines.append(_line(title, listed[kept[0]["like"]], kept, []))
    return cells.markdown(_HEAD, lines)


def _line(title: str, row: Row, runs: Sequence[Outcome], others: Sequence[str]) -> Iterator[str]:
    of = {policy: [run for run in runs if run["policy"] == policy] for policy in (*_PAIR, *others)}
    there = [own for own in of.values() if own]
    best = max((cells.pooled(own).percent for own in there), default=0.0)
    yield title
    yield from (_success(of[policy], best) for policy in _PAIR)
    yield ", ".join(f"{cells.called(policy)}: {_success(of[policy], best)}" for policy in others)
    yield _joined(map(cells.heard, there))
    yield _joined(map(cells.times, there))
    yield _joined(cells.paper(row.paper.get(policy)) for policy in of)
    yield "" if row.random is None else f"{row.random:.1f} %"
    yield "; ".join(dict.fromkeys(map(cells.commits, there)))


def _success(runs: Sequence[Outcome], best: float) -> str:
    return cells.success(runs, cells.pooled(runs).percent == best) if runs else cells.NOT_RUN


def _joined(told: Iterable[str]) -> str:
    """One cell of several, or the one thing that all say."""
    listed = list(told)
    if not any(listed):
        return ""
    return listed[0] if len(set(listed)) == 1 else " / ".join(cell or "-" for cell in listed).replace(" % /", " /")
