"""Training curves of several runs, one panel for each number that was logged."""

from collections.abc import Sequence
from itertools import cycle
from typing import Any

import pandas as pd
from matplotlib.axes import Axes

from lerobot_lisa.analysis.figures.plot import Plot
from lerobot_lisa.analysis.figures.style import GREY, INK, new_figure
from lerobot_lisa.analysis.runs.run import Run, labels

TITLES = {
    "action_loss": "Action loss (per frame)",
    "commitment_loss": "Commitment loss",
    "action_accuracy": "Demonstrated action most probable (share)",
    "perplexity": "Skill codes in effective use (perplexity)",
    "codes_used": "Skill codes used in a batch",
    "mutual_information": "Language-code mutual information (bits)",
}
LOOKS: list[dict[str, Any]] = [
    {"linestyle": line, "color": colour, "marker": marker}
    for marker in ("", "o", "s", "^")
    for colour in (INK, GREY)
    for line in ("-", "--", ":", "-.")
]  # told apart without colours


def training_curves_plot(runs: Sequence[Run], keys: Sequence[str]) -> Plot:
    """One panel for each key that any run has logged.

    Args:
        runs: Drawn in this order.
        keys: Of `TITLES`.
    """
    shown = [key for key in keys if any(key in run.values for run in runs)]
    columns = min(3, len(shown))
    rows = -(-len(shown) // columns)
    figure = new_figure(max(5.0, 4.2 * columns), 3.2 * rows + 0.2 * (len(runs) > 4) * len(runs) / 2)
    named = labels(runs)
    for place, key in enumerate(shown, start=1):
        axes = figure.add_subplot(rows, columns, place)
        for run, label, look in zip(runs, named, cycle(LOOKS), strict=False):
            if key in run.values:
                every = max(1, len(run.steps) // 8)
                axes.plot(run.steps, run.values[key], label=label, markevery=every, markersize=4, linewidth=1.3, **look)
        axes.set(title=TITLES[key], xlabel="training step")
        axes.set_ylim(bottom=0)
        axes.grid(alpha=0.5)
    handles, names = _legend(figure.axes)
    figure.legend(handles, names, loc="outside lower center", ncols=min(len(names), 3 * columns // 2 + 1))
    table = pd.DataFrame(
        [
            (label, step, key, value)
            for run, label in zip(runs, named, strict=True)
            for key in shown
            for step, value in zip(run.steps, run.values.get(key, []), strict=False)
        ],
        columns=["run", "step", "curve", "value"],
    )
    reading = (
        "Numbers of single training batches, so they are rough. Good: losses fall, perplexity stays well above 1, and "
        "mutual information rises and stays up. It is the paper's, from distances to the codes: compare it with other "
        "trainings, not with what a report counts from rollouts."
    )
    return Plot("training_curves", "Training curves", figure, table, reading)


def _legend(panels: Sequence[Axes]) -> tuple[list[Any], list[str]]:
    """Each run once, whichever panels it is in."""
    found: dict[str, Any] = {}
    for axes in panels:
        for handle, name in zip(*axes.get_legend_handles_labels(), strict=True):
            found.setdefault(name, handle)
    return list(found.values()), list(found)
