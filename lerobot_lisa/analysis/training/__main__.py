"""Training curves of one or several runs as one figure and its numbers, from the standard error of `lerobot-train`.

python -m lerobot_lisa.analysis.training outputs/logs/*.log --output_dir=docs/figures
python -m lerobot_lisa.analysis.training outputs/k20.log outputs/k50.log --curves='[mutual_information]'
"""

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import cycle
from pathlib import Path
from typing import Any

import pandas as pd
from matplotlib.axes import Axes

from lerobot_lisa.analysis.commands import run_command
from lerobot_lisa.analysis.drawing import GREY, INK, Plot, new_figure, styled, write
from lerobot_lisa.analysis.training.logs import CURVES, Run, labels, read_log
from lerobot_lisa.errors import UserError

LOOKS: list[dict[str, Any]] = [
    {"linestyle": line, "color": colour, "marker": marker}
    for marker in ("", "o", "s", "^")
    for colour in (INK, GREY)
    for line in ("-", "--", ":", "-.")
]  # told apart without colours


@dataclass
class TrainingConfig:
    """Which runs."""

    logs: list[Path] = field(default_factory=list)
    """Files of `lerobot-train`'s standard error; may also stand before the first option."""

    curves: list[str] = field(default_factory=lambda: list(CURVES))
    """Which to draw."""

    output_dir: Path = field(default_factory=lambda: Path("outputs/training"))
    """For training_curves.png, .pdf and .csv."""

    def __post_init__(self) -> None:
        """Refuse what cannot work."""
        if not self.logs:
            raise UserError("name one or several logs, before the first option")
        if unknown := [name for name in self.curves if name not in CURVES]:
            raise UserError(f"--curves: there is no {unknown[0]!r}: choose from {', '.join(CURVES)}")


def main() -> int:
    """Command line; returns the exit code."""
    return run_command(run, "logs")


def run(config: TrainingConfig) -> None:
    """Read runs and write the figure and its table.

    Raises:
        UserError: See `read_log`; or no run has logged any of the curves.
    """
    runs = [read_log(path) for path in config.logs]
    if not any(key in run.values for run in runs for key in config.curves):
        raise UserError(f"{config.logs[0]}: nothing of {', '.join(config.curves)} was logged: choose other --curves")
    config.output_dir.mkdir(parents=True, exist_ok=True)
    with styled():
        write(training_curves_plot(runs, config.curves), config.output_dir)
    print(f"{len(runs)} runs -> {config.output_dir / 'training_curves.png'}")


def training_curves_plot(runs: Sequence[Run], keys: Sequence[str]) -> Plot:
    """One panel for each key of `CURVES` that any run has logged; runs are drawn in order."""
    shown = [key for key in keys if any(key in run.values for run in runs)]
    columns = min(3, len(shown))
    rows = -(-len(shown) // columns)
    figure = new_figure(max(5.0, 4.2 * columns), 3.2 * rows + 0.2 * (len(runs) > 4) * len(runs) / 2)
    for place, key in enumerate(shown, start=1):
        _draw_curve(figure.add_subplot(rows, columns, place), runs, key)
    drawn = (zip(*axes.get_legend_handles_labels(), strict=True) for axes in figure.axes)
    handles = {name: handle for panel in drawn for handle, name in panel}  # each run once
    figure.legend(
        [*handles.values()], [*handles], loc="outside lower center", ncols=min(len(handles), 3 * columns // 2 + 1)
    )
    logged = [
        (label, step, key, value)
        for run, label in zip(runs, labels(runs), strict=True)
        for key in shown
        for step, value in zip(run.steps, run.values.get(key, []), strict=False)
        if not math.isnan(value)
    ]
    reading = (
        "Numbers of single training batches, so they are rough. Good: losses fall, perplexity stays well above 1, and "
        "mutual information rises and stays up. It is the paper's, from distances to the codes: compare it with other "
        "trainings, not with what a report counts from rollouts."
    )
    table = pd.DataFrame(logged, columns=["run", "step", "curve", "value"])
    return Plot("training_curves", "Training curves", figure, table, reading)


def _draw_curve(axes: Axes, runs: Sequence[Run], key: str) -> None:
    for run, label, look in zip(runs, labels(runs), cycle(LOOKS), strict=False):
        if key in run.values:
            every = max(1, len(run.steps) // 8)
            axes.plot(run.steps, run.values[key], label=label, markevery=every, markersize=4, linewidth=1.3, **look)
    axes.set(title=CURVES[key], xlabel="training step")
    axes.set_ylim(bottom=0)
    axes.grid(alpha=0.5)


if __name__ == "__main__":
    sys.exit(main())
