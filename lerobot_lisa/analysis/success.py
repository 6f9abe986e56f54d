"""Success rates with their uncertainty, from the `eval_info.json` that `lerobot-eval` writes.

python -m lerobot_lisa.analysis.success outputs/eval/*/eval_info.json --json success.json

Several files, such as one for each training seed, are pooled. Beside LOReL's numbers stands what random actions achieve
in the same tasks.
"""

import argparse
import json
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import chain
from pathlib import Path
from typing import Any

from scipy.stats import binomtest

from lerobot_lisa.analysis import lorel_tasks
from lerobot_lisa.errors import UserError, exit_code

OVERALL = "overall"
Outcomes = dict[tuple[str, int], list[bool]]
"""Success of every episode, by (group, task id)."""


@dataclass(frozen=True)
class SuccessRate:
    """How often a policy succeeded.

    Attributes:
        successes: Successful episodes.
        episodes: All episodes, n.
        percent: Success rate in percent.
        low: Lower end of its Wilson 95 % interval, in percent.
        high: Upper end.
    """

    successes: int
    episodes: int
    percent: float
    low: float
    high: float

    def __str__(self) -> str:
        counts = f"{self.successes}/{self.episodes}"
        return f"{counts:>9}  {self.percent:5.1f} %  (95 % interval {self.low:.1f} to {self.high:.1f} %)"


def success_rate(outcomes: Iterable[bool]) -> SuccessRate:
    """Success rate of at least one episode, with the Wilson score interval.

    Wilson's interval (E. B. Wilson, 1927) also holds near 0 and 100 %, where the usual plus-minus does not.
    """
    listed = list(outcomes)
    successes, episodes = sum(listed), len(listed)
    interval = binomtest(successes, episodes).proportion_ci(confidence_level=0.95, method="wilson")
    return SuccessRate(successes, episodes, 100 * successes / episodes, 100 * interval.low, 100 * interval.high)


def read_outcomes(path: Path) -> Outcomes:
    """Outcomes of every episode in an `eval_info.json`, by (group, task id).

    Raises:
        UserError: The file cannot be read, is not what `lerobot-eval` writes, or holds no episode.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise UserError(f"{path}: {error.strerror or error}") from error
    except ValueError as error:
        raise UserError(f"{path}: not JSON ({error}): give the eval_info.json that lerobot-eval wrote") from error
    try:
        outcomes = {(str(task["task_group"]), int(task["task_id"])): _outcomes(task) for task in content["per_task"]}
    except (KeyError, TypeError, ValueError) as error:
        raise UserError(f"{path}: no successes per task in it: give the eval_info.json of lerobot-eval") from error
    if not outcomes or not all(outcomes.values()):
        raise UserError(f"{path}: a task without any episode in it: run lerobot-eval with --eval.n_episodes=100")
    return outcomes


def _outcomes(task: Mapping[str, Any]) -> list[bool]:
    successes = task["metrics"]["successes"]
    if any(outcome not in (True, False) for outcome in successes):
        raise ValueError("an outcome is neither true nor false")
    return [bool(outcome) for outcome in successes]


def pool(files: Iterable[Mapping[tuple[str, int], list[bool]]]) -> Outcomes:
    """Outcomes of several evaluations together, by (group, task id)."""
    pooled: Outcomes = {}
    for outcomes in files:
        for task, listed in outcomes.items():
            pooled.setdefault(task, []).extend(listed)
    return pooled


def summarise(outcomes: Mapping[tuple[str, int], list[bool]]) -> dict[str, SuccessRate]:
    """Success rates of every task ("babyai/0"), of every group ("babyai") and "overall", in this order.

    Suites of several groups, as LOReL's rephrasals, come after the groups.
    """
    return {name: success_rate(chain(*part.values())) for name, part in _parts(outcomes).items()}


def random_floors(outcomes: Mapping[tuple[str, int], list[bool]]) -> dict[str, float]:
    """Success rates of random actions in percent, under the names of `summarise`, where they are known: for LOReL."""
    floors = {name: lorel_tasks.floor(part) for name, part in _parts(outcomes).items()}
    return {name: floor for name, floor in floors.items() if floor is not None}


def _parts(outcomes: Mapping[tuple[str, int], list[bool]]) -> dict[str, Outcomes]:
    """What is counted together, by name."""
    tasks = {f"{group}/{task_id}": {(group, task_id): listed} for (group, task_id), listed in outcomes.items()}
    groups: dict[str, Outcomes] = {}
    suites: dict[str, Outcomes] = {}
    for task, listed in outcomes.items():
        groups.setdefault(task[0], {})[task] = listed
        if suite := lorel_tasks.suite(task):
            suites.setdefault(suite, {})[task] = listed
    return tasks | groups | suites | {OVERALL: dict(outcomes)}


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="+", type=Path, help="eval_info.json of one or several evaluations")
    parser.add_argument("--json", type=Path, help="also write the numbers to this file")
    options = parser.parse_args(arguments)
    return exit_code(lambda: run(options.files, options.json))


def run(files: Sequence[Path], output: Path | None) -> None:
    """Print the rates of each file and of all of them together, and write them to `output` as JSON.

    Raises:
        UserError: See `read_outcomes`.
    """
    outcomes = [read_outcomes(path) for path in files]
    if len(outcomes) > 1:
        for path, listed in zip(files, outcomes, strict=True):
            print(f"{summarise(listed)[OVERALL]}{_beside(random_floors(listed).get(OVERALL))}  {path}")
    pooled = pool(outcomes)
    rates, floors = summarise(pooled), random_floors(pooled)
    instructions = {f"{task[0]}/{task[1]}": lorel_tasks.instruction(task) for task in pooled}
    for name, rate in rates.items():
        said = f": {instructions[name]}" if instructions.get(name) else ""
        print(f"{rate}{_beside(floors.get(name))}  {name}{said}")
    if output:
        _write(output, files, rates, floors, instructions)


def _beside(floor: float | None) -> str:
    return "" if floor is None else f"  random actions {floor:5.1f} %"


def _write(
    path: Path,
    files: Sequence[Path],
    rates: Mapping[str, SuccessRate],
    floors: Mapping[str, float],
    instructions: Mapping[str, str | None],
) -> None:
    numbers: dict[str, dict[str, Any]] = {name: asdict(rate) for name, rate in rates.items()}
    for name, floor in floors.items():
        numbers[name]["random_actions"] = floor
    for name, said in instructions.items():
        numbers[name] |= {"instruction": said} if said else {}
    path.parent.mkdir(parents=True, exist_ok=True)
    text = json.dumps({"files": [str(file) for file in files], "rates": numbers}, indent=2) + "\n"
    path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
