"""Tables for a terminal: rows and where they stand, what a command will take, what came out beside the paper."""

from collections.abc import Iterable, Iterator, Mapping, Sequence

from lerobot_lisa.reproduce import speeds
from lerobot_lisa.reproduce.outcomes import NO_RECIPE, NOT_RUN, RUN, STALE, STARTED, Outcome, State
from lerobot_lisa.reproduce.plan import Run
from lerobot_lisa.reproduce.steps import Step

_WORST_FIRST = (STARTED, STALE, NOT_RUN, RUN, NO_RECIPE)


def overview(states: Sequence[tuple[Run, State]]) -> Iterator[str]:
    """Every run of every row: what it needs, how long it takes or took, where it stands, beside the paper's number."""
    head = ("run", "needs", "estimate", "took", "state", "commit", "success %", "paper %")
    yield from aligned([head, *(_line(run, at) for run, at in states)])
    for row in {run.row.name: run.row for run, _ in states}.values():
        yield from (f"{row.name}: {name} reports {_paper(number)} %" for name, number in row.peers.items())
    counts = {word: sum(at.word == word for _, at in states) for word in _WORST_FIRST}
    yield ", ".join(f"{count} {word}" for word, count in counts.items() if count)


def _line(run: Run, at: State) -> tuple[str, ...]:
    kept = at.outcome or {}
    took = sum(filter(None, kept.get("seconds", {}).values()))
    left = sum(step.seconds for step in run.steps) if run.step else 0
    why = f" ({at.why})" if at.why else ""
    return (
        f"{run.row.name} {run.policy} {run.seed}",
        run.row.family,
        speeds.shown(left) if left else "",
        speeds.shown(took) if took else "",
        at.word + why,
        kept.get("commit", ""),
        success(kept),
        _paper(run.row.paper.get(run.policy)),
    )


def success(kept: Outcome) -> str:
    """Such as "86.3 (82.0 to 89.8)"."""
    rates = kept.get("rates", {})
    return _shown(rates.get("success") or rates.get("unseen"))


def _shown(rate: Mapping[str, float] | None) -> str:
    return f"{rate['percent']:.1f} ({rate['low']:.1f} to {rate['high']:.1f})" if rate else ""


def _paper(number: tuple[float, float] | None) -> str:
    if number is None:
        return ""
    return f"{number[0]:g} ± {number[1]:g}" if number[1] else f"{number[0]:g}"


def estimate(steps: Sequence[Step], jobs: int) -> Iterator[str]:
    """What is still to be done, in the order in which it will be."""
    whole = {step.name: step for last in steps for step in last.chain()}
    left = [step for step in whole.values() if step.note is None]
    yield from aligned([("step", "for", "estimate"), *((s.kind, s.label, speeds.shown(s.seconds)) for s in left)])
    alone = sum(step.seconds for step in left)
    together = max([alone / jobs, *(sum(s.seconds for s in last.chain() if s.note is None) for last in steps)])
    at_once = f", {jobs} at a time" if jobs > 1 else ""
    yield f"{len(left)} of {len(whole)} steps are left: about {speeds.shown(together)} on two cores{at_once}"


def outcomes(states: Iterable[tuple[Run, State]]) -> Iterator[str]:
    """What came out, beside the paper."""
    lines = [("run", "success %", "heard", "SPL", "paper %", "commit", "state")]
    for run, at in states:
        kept = at.outcome or {}
        rates = kept.get("rates", {})
        heard, spl = rates.get("heard"), rates.get("spl")
        lines.append(
            (
                f"{run.row.name} {run.policy} {run.seed}",
                success(kept) or "-",
                f"{heard['points']:.1f} ({heard['low']:.1f} to {heard['high']:.1f})" if heard else "-",
                f"{spl['value']:.2f}" if spl else "-",
                _paper(run.row.paper.get(run.policy)),
                kept.get("commit", ""),
                at.word,
            )
        )
        for part, papers in run.row.parts.items():
            rate = kept.get("parts", {}).get(part, {}).get("success")
            lines.append((f"  {part}", _shown(rate) or "-", "", "", f"{papers.get(run.policy, '')}", "", ""))
    yield from aligned(lines)


def aligned(lines: Sequence[Sequence[str]]) -> Iterator[str]:
    """Columns of equal width."""
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    for line in lines:
        yield "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip()
