"""`lisa-diagnose`: does a policy do what it is told, and do words choose its skill codes?

lisa-diagnose heard --policy.path=... --env.type=babyai --env.task=GoToSeq        # how much of its success is listening
lisa-diagnose swap --policy.path=... --env.type=babyai --env.task=GoToSeq         # same start, other instruction
lisa-diagnose affordance --policy.path=... --env.type=lorel --env.task="close drawer"  # the paper's test
lisa-diagnose rephrase --policy.path=... --env.type=lorel                         # by kind of wording
"""

import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd

from lerobot_lisa.analysis.commands import run_command
from lerobot_lisa.analysis.drawing import styled, write
from lerobot_lisa.analysis.files import write_csv, write_json
from lerobot_lisa.analysis.listening import affordance, heard, rephrase, swap
from lerobot_lisa.analysis.listening.affordance_figure import affordance_plot
from lerobot_lisa.analysis.listening.heard_figure import heard_plot
from lerobot_lisa.analysis.listening.other_words import OTHER, TOLD
from lerobot_lisa.analysis.recording.evaluation import EvaluationConfig
from lerobot_lisa.code_version import made
from lerobot_lisa.errors import UserError


@dataclass(kw_only=True)
class DiagnosisConfig(EvaluationConfig):
    """What to run; options are those of `lerobot-eval`."""

    n_episodes: int = 20
    """Episodes of each task."""

    output_dir: Path = field(default_factory=lambda: Path("outputs/diagnosis"))
    """For the numbers as CSV, figures, and the traces; what an equal earlier run has done is used."""


@dataclass(kw_only=True)
class HeardConfig(DiagnosisConfig):
    """What to run, and what to tell."""

    n_episodes: int = 100
    """Episodes of each task."""

    told: str = OTHER
    """What episodes are told in place of their own instruction: "other", another one, or "nothing", always one word."""

    def __post_init__(self) -> None:
        """Refuse what cannot work."""
        super().__post_init__()
        if self.told not in TOLD:
            raise UserError(f"--told={self.told}: choose one of: {', '.join(TOLD)}")


def main() -> int:
    """Command line; returns the exit code."""
    program, *arguments = sys.argv
    if not arguments or arguments[0] not in _DIAGNOSES:
        print(__doc__, file=sys.stderr if arguments != ["--help"] else sys.stdout)
        return 0 if arguments == ["--help"] else 2
    sys.argv = [f"{program} {arguments[0]}", *arguments[1:]]  # which LeRobot's parser reads
    return run_command(_DIAGNOSES[arguments[0]])


def diagnose_heard(config: HeardConfig) -> None:
    """Tell every episode its own and another instruction; success is its own goal both times."""
    runs = heard.measure(config, config.output_dir / "heard", config.told)
    seeds = f"seeds {config.seed} to {config.seed + config.n_episodes - 1}"
    with styled():
        write(heard_plot(runs, f"{len(runs.pairs):,} episodes, {seeds}"), config.output_dir)
    write_json({**heard.as_json(runs), "made": made()}, config.output_dir / "heard.json", indent=2)
    print(*heard.lines(runs), heard.READING, config.output_dir / "heard.json", sep="\n")
    if runs.otherwise is None:
        raise UserError(
            f"--env.task={getattr(config.env, 'task', None)}: every episode is told the same, there is nothing else to "
            "tell: heard cannot be measured"
        )


def diagnose_swap(config: DiagnosisConfig) -> None:
    """Tell every episode its own and another instruction."""
    runs = swap.measure(config)
    _report(config, "swap", swap.table(runs), swap.lines(runs), swap.READING)


def diagnose_affordance(config: DiagnosisConfig) -> None:
    """Say everything about one scene."""
    trace = affordance.measure(config)
    code = affordance.own_code(trace)
    rows = affordance.table(trace, code)
    sample = f"same starts for each, seeds {config.seed} to {config.seed + config.n_episodes - 1}"
    with styled():
        write(affordance_plot(rows, trace.code_labels[code], affordance.READING, sample), config.output_dir)
    print(*affordance.lines(trace), affordance.READING, config.output_dir / "affordance.png", sep="\n")


def diagnose_rephrase(config: DiagnosisConfig) -> None:
    """Say the same in other words."""
    trace = rephrase.measure(config)
    _report(config, "rephrase", rephrase.table(trace), rephrase.lines(trace), rephrase.READING)


def _report(config: DiagnosisConfig, name: str, rows: pd.DataFrame, lines: Iterable[str], reading: str) -> None:
    config.output_dir.mkdir(parents=True, exist_ok=True)
    path = config.output_dir / f"{name}.csv"
    write_csv(rows, path)
    print(*lines, reading, path, sep="\n")


_DIAGNOSES: dict[str, Callable[[Any], None]] = {
    "heard": diagnose_heard,
    "swap": diagnose_swap,
    "affordance": diagnose_affordance,
    "rephrase": diagnose_rephrase,
}


if __name__ == "__main__":
    sys.exit(main())
