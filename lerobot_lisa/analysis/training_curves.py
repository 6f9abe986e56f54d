"""Training curves of one or several runs as one figure and its numbers: from logs, or from wandb's offline files.

python -m lerobot_lisa.analysis.training_curves outputs/logs/*.log --output-dir docs/figures
python -m lerobot_lisa.analysis.training_curves outputs/k20_h10 outputs/k50_h10 outputs/k50_h5 \
    --curves mutual_information --output-dir outputs/mutual_information
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from lerobot_lisa.analysis.figures.plot import write
from lerobot_lisa.analysis.figures.style import styled
from lerobot_lisa.analysis.figures.training_curves import training_curves_plot
from lerobot_lisa.analysis.runs.log import read_log
from lerobot_lisa.analysis.runs.run import CURVES, Run
from lerobot_lisa.analysis.runs.wandb_file import find_wandb_file, read_wandb
from lerobot_lisa.errors import UserError, exit_code


def read(path: Path) -> Run:
    """Read a run from a log, from a `.wandb` file, or from a folder with one of these in it.

    Raises:
        UserError: There is no training in it.
    """
    if path.is_dir():
        return read_wandb(find_wandb_file(path))
    return read_wandb(path) if path.suffix == ".wandb" else read_log(path)


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "runs", nargs="+", type=Path, help="standard error of lerobot-train, .wandb files, or folders with one"
    )
    parser.add_argument("--curves", nargs="+", choices=CURVES, default=CURVES, help="which to draw (default: all)")
    parser.add_argument("--output-dir", type=Path, default=Path(), help="for training_curves.png, .pdf and .csv")
    options = parser.parse_args(arguments)
    return exit_code(lambda: run(options.runs, options.curves, options.output_dir))


def run(paths: Sequence[Path], curves: Sequence[str], output_dir: Path) -> None:
    """Read runs and write the figure and its table.

    Raises:
        UserError: See `read`; or no run has logged any of the curves.
    """
    runs = [read(path) for path in paths]
    if not any(key in run.values for run in runs for key in curves):
        raise UserError(f"{paths[0]}: nothing of {', '.join(curves)} was logged: choose other --curves")
    output_dir.mkdir(parents=True, exist_ok=True)
    with styled():
        write(training_curves_plot(runs, curves), output_dir)
    print(f"{len(runs)} runs -> {output_dir / 'training_curves.png'}")


if __name__ == "__main__":
    sys.exit(main())
