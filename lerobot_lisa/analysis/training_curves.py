"""Training curves of one or several runs from `lerobot-train`'s own logs, as one figure and its numbers.

python -m lerobot_lisa.analysis.training_curves outputs/logs/*.log --output-dir docs/figures
"""

import argparse
import csv
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from lerobot_lisa.errors import UserError, exit_code

# The keys that lerobot-train and the policies log, and how they are called in the figure.
CURVES = {
    "action_loss": "action loss (nats per frame)",
    "action_accuracy": "demonstrated action most probable (share)",
    "perplexity": "skill codes in effective use (perplexity)",
    "mutual_information": "language-code mutual information (bits)",
}
STYLES = ("-", "--", ":", "-.")  # readable in black and white


class Run(NamedTuple):
    """One training run.

    Attributes:
        name: Its log's file name.
        steps: Step of each logged line.
        values: Logged numbers by key, one for each line.
    """

    name: str
    steps: list[int]
    values: dict[str, list[float]]


def read_log(path: Path) -> Run:
    """Read a log that `lerobot-train` has written to standard error.

    The log rounds steps ("step:1K"), so they are counted: line k is step k times `log_freq`.

    Raises:
        UserError: The file cannot be read or is no such log.
    """
    try:
        text = path.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        raise UserError(f"{path}: {error.strerror or error}") from error
    frequency = re.search(r"'log_freq': (\d+)", text)
    lines = re.findall(r"\bstep:\S+ smpl:.*", text)
    if frequency is None or not lines:
        raise UserError(f"{path}: no lines of lerobot-train's log in it; keep the command's standard error in a file")
    rows = [
        {key: float(value) for key, value in re.findall(r"(\w+):(-?[\d.]+(?:e[-+]?\d+)?)(?= |$)", line)}
        for line in lines
    ]
    steps = [int(frequency[1]) * count for count in range(1, len(rows) + 1)]
    return Run(path.stem, steps, {key: [row[key] for row in rows] for key in CURVES if all(key in row for row in rows)})


def draw(runs: list[Run], output: Path) -> None:
    """One panel for each curve that any run has logged, written as PNG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    keys = [key for key in CURVES if any(key in run.values for run in runs)]
    figure = Figure(figsize=(5 * len(keys), 4), layout="constrained")
    for panel, key in enumerate(keys):
        axes = figure.add_subplot(1, len(keys), panel + 1)
        for index, run in enumerate(run for run in runs if key in run.values):
            axes.plot(run.steps, run.values[key], STYLES[index % len(STYLES)], label=run.name)
        axes.set(title=CURVES[key], xlabel="training step")
        axes.grid(alpha=0.3)
        axes.legend(fontsize="small")
    FigureCanvasAgg(figure).print_png(output)


def write_table(runs: list[Run], output: Path) -> None:
    """The figure's numbers: one row for each run, step and curve."""
    with output.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(["run", "step", "curve", "value"])
        for run in runs:
            for key, values in run.values.items():
                table.writerows([run.name, step, key, value] for step, value in zip(run.steps, values, strict=True))


def main() -> int:
    """Command line; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("logs", nargs="+", type=Path, help="standard error of lerobot-train")
    parser.add_argument("--output-dir", type=Path, default=Path(), help="for training_curves.png and .csv")
    options = parser.parse_args()
    return exit_code(lambda: run(options.logs, options.output_dir))


def run(logs: Sequence[Path], output_dir: Path) -> None:
    """Read the logs and write figure and table.

    Raises:
        UserError: See `read_log`.
    """
    runs = [read_log(path) for path in logs]
    output_dir.mkdir(parents=True, exist_ok=True)
    draw(runs, output_dir / "training_curves.png")
    write_table(runs, output_dir / "training_curves.csv")
    print(f"{len(runs)} runs -> {output_dir / 'training_curves.png'}")


if __name__ == "__main__":
    sys.exit(main())
