"""How much of a policy's success is listening: the same episodes told otherwise, and steps against a demonstrator's."""

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from lerobot_lisa.analysis.listening import reactions
from lerobot_lisa.analysis.listening.demonstrators import demonstrator_steps
from lerobot_lisa.analysis.listening.other_words import NOTHING, OTHER, other_words, several_tasks
from lerobot_lisa.analysis.listening.paired import Difference, difference
from lerobot_lisa.analysis.listening.steps import BUDGETS, Spl, spl, steps_to_success
from lerobot_lisa.analysis.listening.telling import Told, telling
from lerobot_lisa.analysis.recording.evaluation import Evaluation, EvaluationConfig, load
from lerobot_lisa.analysis.recording.record import record
from lerobot_lisa.analysis.recording.traces import KEY, STEPS_FILE, Trace
from lerobot_lisa.analysis.success.breakdown import task_names
from lerobot_lisa.analysis.success.rates import SuccessRate, success_rate
from lerobot_lisa.errors import UserError

READING = (
    "Success is reaching the episode's own goal, whatever the policy is told. Good: heard is near the success rate; 0 "
    "is a policy that does the same whatever it is told. Who has done something else may still come past the own goal "
    "later, so within few steps heard says more. Good: SPL near 1; a policy that solves everything late has little."
)
NO_DEMONSTRATOR = "no demonstrator in this world, and so no SPL and no budgets"
OVERALL, _OWN = "overall", "told_own"
Loader = Callable[[EvaluationConfig], Evaluation]


@dataclass(frozen=True)
class Comparison:
    """Success, and how much of it is listening.

    Attributes:
        success: Told the episode's own instruction, all episodes.
        told_otherwise: The same goal reached when told something else; None, like `heard`, if there is nothing else.
        heard: Success minus that, of the same episodes.
    """

    success: SuccessRate
    told_otherwise: SuccessRate | None
    heard: Difference | None


@dataclass(frozen=True)
class Listening(Comparison):
    """The same, and how it compares with a demonstrator.

    Attributes:
        spl: Success weighted by path length; None, like `budgets`, if there is no demonstrator.
        budgets: The comparison within so many times the demonstrator's steps.
    """

    spl: Spl | None
    budgets: dict[int, Comparison] | None


@dataclass(frozen=True)
class Runs:
    """Recorded episodes, told their own instruction and told otherwise.

    Attributes:
        told: `other_words.OTHER` or `NOTHING`.
        own: Told their own instruction.
        otherwise: Told otherwise; None: there is nothing else to tell.
        pairs: A row for each episode, by `traces.KEY`: `success`, `steps` until success or inf, `told_otherwise` and
            `steps_otherwise` (nan where it was not told otherwise), `demonstrator` (nan where there is none).
    """

    told: str
    own: Trace
    otherwise: Trace | None
    pairs: pd.DataFrame


def measure(
    config: EvaluationConfig,
    folder: Path,
    told: str = OTHER,
    own: Trace | None = None,
    load: Loader = load,
) -> Runs:
    """Run every episode twice, from the same start with the same random numbers; what was recorded before is used.

    Args:
        config: What to evaluate.
        folder: For the traces and the demonstrator's steps.
        told: What the second run is told, `OTHER` or `NOTHING`.
        own: The first run, if it has been recorded already.
        load: Loads the policy and its environments.

    Raises:
        UserError: The evaluation cannot work.
    """
    own = own or record(config, folder / _OWN, evaluation=_load_to_tell(config, folder / _OWN, told, load))
    words, otherwise = other_words(told, config.env, own.episodes), None
    if words:
        evaluation = _unless_recorded(config, folder / f"told_{told}", load)
        evaluation = telling(evaluation, words) if evaluation else None
        otherwise = record(config, folder / f"told_{told}", evaluation=evaluation, listening=told)
    demonstrator = demonstrator_steps(config.env, own.episodes, folder)
    return Runs(told, own, otherwise, _pairs(own, otherwise, words, demonstrator))


def _load_to_tell(config: EvaluationConfig, folder: Path, told: str, load: Loader) -> Evaluation | None:
    """For the first run: look before it whether there will be a second one."""
    evaluation = _unless_recorded(config, folder, load)
    if evaluation and told == OTHER and not several_tasks(config.env, evaluation.envs):
        raise UserError(
            f"--env.type={config.env.type} offers one task here, and nothing else can be told in it: name several with "
            f"--env.task, or measure with --told={NOTHING}"
        )
    return evaluation


def _unless_recorded(config: EvaluationConfig, folder: Path, load: Loader) -> Evaluation | None:
    return None if (folder / STEPS_FILE).is_file() else load(config)


def _pairs(own: Trace, otherwise: Trace | None, words: Told, demonstrator: pd.Series | None) -> pd.DataFrame:
    episodes = own.episodes.set_index(KEY)
    pairs = pd.DataFrame({"success": episodes["success"], "steps": steps_to_success(own)})
    pairs["told_otherwise"], pairs["steps_otherwise"] = np.nan, np.nan
    if otherwise is not None:
        told = [seed in words.get(key[:2], {}) for key, seed in episodes["seed"].items()]
        success = otherwise.episodes.set_index(KEY)["success"].astype(float)
        pairs["told_otherwise"] = success.reindex(pairs.index).where(told)
        pairs["steps_otherwise"] = steps_to_success(otherwise).reindex(pairs.index).where(told)
    pairs["demonstrator"] = np.nan if demonstrator is None else demonstrator
    return pairs


def listening(pairs: pd.DataFrame) -> Listening:
    """The numbers of some of the pairs of `Runs`, or of all."""
    whole, solved = _compare(pairs), pairs.dropna(subset="demonstrator")
    if not len(solved):
        return Listening(**vars(whole), spl=None, budgets=None)
    short = spl(solved["steps"].to_numpy(), solved["demonstrator"].to_numpy())
    budgets = {budget: _compare(solved, budget * solved["demonstrator"]) for budget in BUDGETS}
    return Listening(**vars(whole), spl=short, budgets=budgets)


def _compare(pairs: pd.DataFrame, most: pd.Series | float = np.inf) -> Comparison:
    """Both runs, of success within at most so many steps."""
    own = (pairs["steps"] <= most) & pairs["success"]
    told = pairs["told_otherwise"].notna()
    if not told.any():
        return Comparison(success_rate(own), None, None)
    other = ((pairs["steps_otherwise"] <= most) & (pairs["told_otherwise"] == 1))[told]
    return Comparison(success_rate(own), success_rate(other), difference(own[told].tolist(), other.tolist()))


def by_part(runs: Runs) -> dict[str, Listening]:
    """The numbers of every task, if there are several, and of all episodes."""
    names = task_names(runs.own)
    parts = {}
    if len(names) > 1:
        parts = {names[task]: listening(part) for task, part in runs.pairs.groupby(KEY[:2], sort=False, observed=True)}
    return parts | {OVERALL: listening(runs.pairs)}


def table(runs: Runs) -> pd.DataFrame:
    """A row for each number of each part: columns `part`, `number`, `unit`, `value`, `low`, `high`, `episodes`."""
    rows = [(part, *row) for part, of_part in by_part(runs).items() for row in _rows(of_part)]
    return pd.DataFrame(rows, columns=["part", "number", "unit", "value", "low", "high", "episodes"])


def _rows(numbers: Listening) -> Iterator[tuple[str, str, float, float, float, int]]:
    yield from _compared(numbers, "")
    if short := numbers.spl:
        yield "SPL", "", short.value, short.low, short.high, short.episodes
    for budget, within in (numbers.budgets or {}).items():
        yield from _compared(within, f" within {budget} x")


def _compared(numbers: Comparison, within: str) -> Iterator[tuple[str, str, float, float, float, int]]:
    for name, rate in (("success", numbers.success), ("told otherwise", numbers.told_otherwise)):
        if rate is not None:
            yield name + within, "%", rate.percent, rate.low, rate.high, rate.episodes
    if heard := numbers.heard:
        yield f"heard{within}", "points", heard.points, heard.low, heard.high, heard.episodes


def as_json(runs: Runs) -> dict[str, Any]:
    """The numbers and where they come from, JSON values."""
    parts = {name: asdict(of_part) for name, of_part in by_part(runs).items()}
    return {"told": runs.told, "rates": parts, "evaluation": dict(runs.own.origin)}


def lines(runs: Runs) -> Iterator[str]:
    """The numbers for people."""
    for name, of_part in by_part(runs).items():
        yield from _lines(of_part, "" if name == OVERALL else f"{name}: ")
    if runs.otherwise is not None:
        both = runs.pairs.index[runs.pairs["told_otherwise"].notna()]
        own, other = (trace.steps.set_index(KEY).loc[both].reset_index() for trace in (runs.own, runs.otherwise))
        yield from reactions.lines(own, other)


def _lines(numbers: Listening, part: str) -> Iterator[str]:
    yield f"{numbers.success}  {part}success, told the episode's own instruction"
    if numbers.heard is not None:
        yield f"{numbers.told_otherwise}  {part}same goal, told otherwise"
        yield f"{numbers.heard}  {part}heard"
    if numbers.spl is None or numbers.budgets is None:
        yield f"{'':>9}  {part}{NO_DEMONSTRATOR}"
        return
    yield f"{numbers.spl}  {part}SPL"
    for budget, within in numbers.budgets.items():
        yield f"{within.success}  {part}success within {budget} x the demonstrator's steps"
        if within.heard is not None:
            yield f"{within.heard}  {part}heard within {budget} x the demonstrator's steps"


def key_numbers(runs: Runs) -> list[tuple[str, str, str]]:
    """For the top of a report: name, number, what it means."""
    numbers, listed = listening(runs.pairs), []
    if heard := numbers.heard:
        interval = f"95 % interval {heard.low:.1f} to {heard.high:.1f}"
        meaning = f"success lost when told something else, of {numbers.success.percent:.1f} %; {interval}"
        listed.append(("Heard", f"{heard.points:.1f} points", meaning))
    if short := numbers.spl:
        meaning = (
            f"success weighted by the demonstrator's steps / its own; 95 % interval {short.low:.2f} to {short.high:.2f}"
        )
        listed.append(("SPL", f"{short.value:.2f}", meaning))
    return listed
