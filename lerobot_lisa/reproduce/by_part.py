"""Tables of one row's parts, such as instructions or kinds of wording: ours, the paper's, other papers'."""

from collections.abc import Iterable, Iterator, Sequence

from lerobot_lisa.reproduce import cells
from lerobot_lisa.reproduce.outcomes import Outcome
from lerobot_lisa.reproduce.rows import Row


def by_part(runs: Sequence[Outcome], rows: Iterable[Row]) -> str:
    """A table for each row that names parts, one under the other.

    Args:
        runs: Published.
        rows: Those without parts are left out.
    """
    return "\n\n".join(_table([run for run in runs if run["row"] == row.title], row) for row in rows if row.parts)


def _table(runs: Sequence[Outcome], row: Row) -> str:
    named = dict.fromkeys(name for told in row.parts.values() for name in told)
    peers = [name for name in named if name not in row.policies]
    head = [
        row.title,
        *map(cells.called, row.policies),
        *(f"{cells.called(policy)}, the paper" for policy in row.policies),
        *peers,
    ]
    return cells.markdown(head, (_line(part, runs, row, peers) for part in row.parts))


def _line(part: str, runs: Sequence[Outcome], row: Row, peers: Sequence[str]) -> Iterator[str]:
    yield part
    for policy in row.policies:
        own = [{"rates": run["parts"][part]} for run in runs if run["policy"] == policy and part in run["parts"]]
        yield cells.success(own, bold=False) if own else cells.NOT_RUN
    for name in (*row.policies, *peers):
        yield cells.paper((row.parts[part][name], 0) if name in row.parts[part] else None)
