"""Success rates with their uncertainty, from the `eval_info.json` that `lerobot-eval` writes.

python -m lerobot_lisa.analysis.success outputs/eval/*/eval_info.json --json success.json

Several files, such as one for each training seed, are pooled.
"""

import argparse
import json
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from scipy.stats import binomtest

from lerobot_lisa.errors import UserError, exit_code

OVERALL = "overall"


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


def read_outcomes(path: Path) -> dict[tuple[str, int], list[bool]]:
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


def pool(files: Iterable[Mapping[tuple[str, int], list[bool]]]) -> dict[tuple[str, int], list[bool]]:
    """Outcomes of several evaluations together, by (group, task id)."""
    pooled: dict[tuple[str, int], list[bool]] = {}
    for outcomes in files:
        for task, listed in outcomes.items():
            pooled.setdefault(task, []).extend(listed)
    return pooled


def summarise(outcomes: Mapping[tuple[str, int], list[bool]]) -> dict[str, SuccessRate]:
    """Success rates of every task ("babyai/0"), of every group ("babyai") and "overall", in this order."""
    groups: dict[str, list[bool]] = {}
    for (group, _), listed in outcomes.items():
        groups.setdefault(group, []).extend(listed)
    everything = [outcome for listed in outcomes.values() for outcome in listed]
    named = {f"{group}/{task}": listed for (group, task), listed in outcomes.items()} | groups | {OVERALL: everything}
    return {name: success_rate(listed) for name, listed in named.items()}


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
            print(f"{summarise(listed)[OVERALL]}  {path}")
    rates = summarise(pool(outcomes))
    for name, rate in rates.items():
        print(f"{rate}  {name}")
    if output:
        numbers = {"files": [str(path) for path in files], "rates": {k: asdict(v) for k, v in rates.items()}}
        output.parent.mkdir(parents=True, exist_ok=True)
        output.write_text(json.dumps(numbers, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
