"""`lisa-diagnose`: does a policy do what it is told, and do words choose its skill codes?

lisa-diagnose swap --policy.path=... --env.type=babyai --env.task=GoToSeq         # same start, other instruction
lisa-diagnose affordance --policy.path=... --env.type=lorel --env.task="close drawer"  # the paper's test
lisa-diagnose rephrase --policy.path=... --env.type=lorel                         # by kind of wording
"""

import sys
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import pandas as pd
from lerobot.configs import parser
from lerobot.utils.import_utils import register_third_party_plugins

from lerobot_lisa.analysis.diagnostics import affordance, rephrase, swap
from lerobot_lisa.analysis.recording.evaluation import EvaluationConfig
from lerobot_lisa.errors import exit_code


@dataclass
class DiagnosisConfig(EvaluationConfig):
    """What to run; options are those of `lerobot-eval`."""

    n_episodes: int = 20
    """Episodes of each task."""

    output_dir: Path = field(default_factory=lambda: Path("outputs/diagnosis"))
    """For the numbers as CSV, and the traces; what an equal earlier run has done is used."""


def main() -> int:
    """Command line; returns the exit code."""
    program, *arguments = sys.argv
    if not arguments or arguments[0] not in _DIAGNOSES:
        print(__doc__, file=sys.stderr if arguments != ["--help"] else sys.stdout)
        return 0 if arguments == ["--help"] else 2
    sys.argv = [f"{program} {arguments[0]}", *arguments[1:]]  # which LeRobot's parser reads
    register_third_party_plugins()
    diagnose = parser.wrap()(_DIAGNOSES[arguments[0]])
    return exit_code(diagnose, interrupted="interrupted; run the same command again to go on")


def diagnose_swap(config: DiagnosisConfig) -> None:
    """Tell every episode its own and another instruction."""
    arms = swap.measure(config)
    _report(config, "swap", swap.table(arms), swap.lines(arms), swap.READING)


def diagnose_affordance(config: DiagnosisConfig) -> None:
    """Say everything about one scene."""
    trace = affordance.measure(config)
    rows = affordance.table(trace, affordance.own_code(trace))
    _report(config, "affordance", rows, affordance.lines(trace), affordance.READING)


def diagnose_rephrase(config: DiagnosisConfig) -> None:
    """Say the same in other words."""
    trace = rephrase.measure(config)
    _report(config, "rephrase", rephrase.table(trace), rephrase.lines(trace), rephrase.READING)


def _report(config: DiagnosisConfig, name: str, rows: pd.DataFrame, lines: Iterable[str], reading: str) -> None:
    config.output_dir.mkdir(parents=True, exist_ok=True)
    path = config.output_dir / f"{name}.csv"
    rows.to_csv(path, index=False, float_format="%.6g", lineterminator="\n")
    print(*lines, reading, path, sep="\n")


_DIAGNOSES = {"swap": diagnose_swap, "affordance": diagnose_affordance, "rephrase": diagnose_rephrase}


if __name__ == "__main__":
    sys.exit(main())
