"""`lisa-rollout`: episodes under skill codes of your choice, as videos, with a trace and their success.

lisa-rollout --policy.path=... --env.type=lorel --env.task="close drawer" --skill=14        # one code, whole episode
lisa-rollout --policy.path=... --env.type=lorel --env.task=compositions --plan="14*20,2*20"  # one code after another
lisa-rollout --policy.path=... --env.type=lorel --env.task=seen --plan="?*10,14*10"          # override from step 10 on
lisa-rollout --policy.path=... --env.type=lorel --env.task=seen --skill=all                  # every task, every code
"""

import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path

from lerobot_lisa.analysis import drawing
from lerobot_lisa.analysis.commands import check_number, run_command
from lerobot_lisa.analysis.control import matrix
from lerobot_lisa.analysis.control.videos import VideoWriter
from lerobot_lisa.analysis.recording.evaluation import EvaluationConfig, lisa_config, steered
from lerobot_lisa.analysis.recording.record import record
from lerobot_lisa.analysis.recording.traces import KEY, Trace
from lerobot_lisa.analysis.success import breakdown
from lerobot_lisa.errors import UserError

ALL = "all"
_LISTED = 10  # episodes of each task that are printed


@dataclass(kw_only=True)
class RolloutConfig(EvaluationConfig):
    """What to run, and which skill codes to follow."""

    n_episodes: int = 10
    """Episodes of each task."""

    output_dir: Path = field(default_factory=lambda: Path("outputs/rollout"))
    """Where videos and the trace go; an equal evaluation found there is used."""

    skill: str | None = None
    """A skill code for the whole episode, or "all" for a matrix of every task under every code, without videos."""

    plan: str | None = None
    """Skill codes and steps such as "14*20,2*20"; `?` leaves the choice to the skill predictor, as in "?*10,14*10",
    and so does the end of the plan. Steps need not be multiples of the horizon.
    """

    n_videos: int = 4
    """Episodes of each task that are filmed, the first ones."""

    def __post_init__(self) -> None:
        """Refuse what cannot work."""
        super().__post_init__()
        if self.skill is not None and self.plan is not None:
            raise UserError("--skill and --plan exclude each other: a plan of one code is --skill")
        if self.skill is not None and set(self.skill) & set("*,?"):
            shown = drawing.clip(self.skill)
            raise UserError(f"--skill={shown}: give one skill code, such as 14, or all; for several use --plan")
        check_number("n_videos", self.n_videos, 0, 1_000_000)
        if self.skill == ALL:
            lisa_config(self)


def main() -> int:
    """Command line; returns the exit code."""
    return run_command(run)


def run(config: RolloutConfig) -> None:
    """Run, film and print; what an equal earlier run has done is used.

    Raises:
        UserError: The checkpoint, the environment, the codes or the folder cannot be used.
    """
    if config.skill == ALL:
        _run_matrix(config)
        return
    plan = config.plan if config.skill is None else config.skill
    chosen = config if plan is None else steered(config, plan)
    videos = config.output_dir / "videos"
    films = [VideoWriter(videos, config.n_videos)] if config.n_videos else []
    trace = record(chosen, config.output_dir, films, n_videos=config.n_videos)
    print(*summary(trace), sep="\n")
    print(config.output_dir)
    if films and not any(videos.rglob("*.mp4")):
        raise UserError(f"{videos} is gone, and what is recorded is not run again: choose another --output_dir to film")


def _run_matrix(config: RolloutConfig) -> None:
    measured = matrix.measure(config)
    sample = f"n = {config.n_episodes} each, seeds {config.seed} to {config.seed + config.n_episodes - 1}"
    drawn = [matrix.matrix_plot(measured.tasks, sample), matrix.starts_plot(measured.starts, sample)]
    print(*matrix.said(measured.tasks), sep="\n")
    for plot in drawn:
        with drawing.styled():
            drawing.write(plot, config.output_dir)
        print(plot.reading)
        print(config.output_dir / f"{plot.name}.png")


def summary(trace: Trace) -> Iterator[str]:
    """Lines about the first episodes of each task, what codes they followed, and the success rate of each task."""
    names = breakdown.task_names(trace)
    codes = trace.steps.groupby(KEY, sort=False, observed=True)["code"]
    followed = {key: as_plan(part.dropna()) + called(part.dropna(), trace) for key, part in codes}
    for row in trace.episodes.itertuples():
        if row.episode < _LISTED:
            ended = "success" if row.success else "failure"
            path = followed[row.group, row.task_id, row.episode] or "no skill codes"
            name = drawing.clip(names[row.group, row.task_id], 100)
            yield f"{name}  seed {row.seed}  {ended} after {row.steps} steps  {path}"
    yield from breakdown.said(breakdown.by_task(trace))


def as_plan(codes: Iterable[int]) -> str:
    """The codes of an episode's steps as a plan, such as "14*20,2*7"."""
    return ",".join(f"{code}*{len(list(steps))}" for code, steps in groupby(codes))


def called(codes: Iterable[int], trace: Trace) -> str:
    """What the codes are called, in the order of their first use, such as " (14 red ball, 2 grey key)"; "" if only
    by their numbers."""
    labels = trace.code_labels if trace.has_codes else []
    names = [drawing.shorten(labels[code]) for code in dict.fromkeys(codes) if labels[code] != str(code)]
    return f" ({', '.join(names)})" if names else ""


if __name__ == "__main__":
    sys.exit(main())
