"""The paper's table 3: how many instructions of a level no demonstration has said, of all and by form."""

from collections.abc import Iterable, Iterator, Mapping, Sequence

from lerobot_lisa.reproduce import cells
from lerobot_lisa.reproduce.outcomes import Outcome
from lerobot_lisa.reproduce.rows import DATA_ONLY, Row
from lerobot_lisa.reproduce.tables import place

_FORMS = {
    "single action": "one action",
    "two in any order": "two in any order",
    "one after another": "one after another",
}


def unseen_words(runs: Sequence[Outcome], rows: Iterable[Row]) -> str:
    """A line for each row in which nothing is trained.

    Args:
        runs: Published.
        rows: Those that train are left out.
    """
    only_data = [row for row in rows if row.policies == (DATA_ONLY,)]
    only_data.sort(key=lambda row: place(row.title, 0, DATA_ONLY))
    lines = (_line(row, next((run for run in runs if run["row"] == row.title), None)) for row in only_data)
    return cells.markdown(("demonstrations", "here", "the paper", *_FORMS.values(), "commit"), lines)


def _line(row: Row, run: Outcome | None) -> Iterator[str]:
    yield row.title.partition(",")[0]
    yield cells.success([{"rates": {"success": run["rates"]["unseen"]}}], bold=False) if run else cells.NOT_RUN
    yield cells.paper(row.paper.get(DATA_ONLY))
    for form in _FORMS:
        yield _count(run["parts"][form]["unseen"]) if run else ""
    yield cells.commits([run]) if run else ""


def _count(rate: Mapping[str, float]) -> str:
    return f"{rate['percent']:.1f} % of {rate['episodes']:,}"
