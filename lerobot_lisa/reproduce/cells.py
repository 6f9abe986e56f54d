"""What stands in the cells of tables: names, success, heard, the paper's number, links; and the Markdown around."""

from collections.abc import Iterable, Sequence

from lerobot_lisa.analysis.material import POLICIES
from lerobot_lisa.analysis.success.rates import SuccessRate, success_rate
from lerobot_lisa.reproduce.outcomes import Outcome
from lerobot_lisa.reproduce.rows import DATA_ONLY, Row

NAMES = {**POLICIES, DATA_ONLY: "no policy"}
NOT_RUN = "not run"


def called(policy: str) -> str:
    """A policy's name, and after how many steps it was evaluated: "lisa@500"."""
    kind, _, steps = policy.partition("@")
    return NAMES.get(kind, kind) + (f", {int(steps):,} steps" if steps else "")


def pooled(runs: Sequence[Outcome]) -> SuccessRate:
    """Success of several seeds together."""
    rates = [run["rates"]["success"] for run in runs]
    successes, episodes = (sum(rate[name] for rate in rates) for name in ("successes", "episodes"))
    return success_rate([True] * successes + [False] * (episodes - successes))


def success(runs: Sequence[Outcome], bold: bool = True) -> str:
    """Success of several seeds with its interval."""
    rate = pooled(runs)
    shown = f"{rate.percent:.1f} %"
    return f"{f'**{shown}**' if bold else shown} ({rate.low:.1f} to {rate.high:.1f})"


def heard(runs: Iterable[Outcome]) -> str:
    """Of each seed, in points."""
    return ", ".join(f"{run['rates']['heard']['points']:.1f}" for run in runs if run["rates"].get("heard"))


def times(runs: Sequence[Outcome]) -> str:
    """How many seeds, and episodes of each."""
    return f"{len(runs)} x {runs[0]['rates']['success']['episodes']:,}"


def paper(number: tuple[float, float] | None) -> str:
    """Percent, and what is said behind plus-minus."""
    if number is None:
        return ""
    return f"{number[0]:g} ± {number[1]:g} %" if number[1] else f"{number[0]:g} %"


def commits(runs: Iterable[Outcome]) -> str:
    """Each commit leads to the file, which has the commands."""
    links = {run.get("link") or f"results/{run['file']}": run["commit"] for run in runs}
    return ", ".join(f"[{commit}]({link})" for link, commit in links.items())


def own_limit(row: Row | None) -> str:
    """Whose limit of steps holds where a row names none."""
    world = row.family if row else ""
    return {"babyai": "BabyAI's", "lorel": "LOReL's", "metaworld": "Meta-World's"}.get(world, "its") + " own"


def markdown(head: Sequence[str], lines: Iterable[Iterable[object]]) -> str:
    """A table."""
    whole = [" | ".join(map(str, line)) for line in (head, *lines)]
    return "\n".join([f"| {whole[0]} |", f"|{'---|' * len(head)}", *(f"| {line} |" for line in whole[1:])])
