"""Measure how fast everything is against named alternatives, and print the table.

    python -m benchmarks                                  the whole table
    python -m benchmarks windows bot --repeats 5          some of its parts
    python -m benchmarks --json new.json --compare old.json
    python -m benchmarks --rows new.json --compare old.json   files of earlier runs, without measuring

Both sides of a row do the same work in the same process, in turns; figures are medians over the repeats. Data are read
from the dataset in --root, which this makes:

    python -m dataset_converters.babyai generate --level GoToSeq --episodes 1000 \\
        --root data/gotoseq_1k --repo-id local/babyai_gotoseq_1k
"""

import argparse
import importlib
import logging
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from benchmarks.table import Row, as_markdown, comparison, details, load, save
from lerobot_lisa.errors import UserError, exit_code

os.environ.setdefault("HF_HUB_OFFLINE", "1")  # before a part imports LeRobot
logging.getLogger("lerobot.utils.import_utils").setLevel(logging.ERROR)  # sixty lines about video that nobody uses here

PARTS = {
    "windows": "windows and whole episodes from the episode store",
    "train": "lerobot-train against a bare loop, and how long it waits for data",
    "model": "a training step against a padded implementation of the paper",
    "asking": "a training step with and without asking what is seen, by words and skill codes",
    "images": "the image encoder against the obvious one",
    "compiled": "a training step with and without torch.compile",
    "act": "select_action late in an episode",
    "evaluate": "100 episodes in a batch",
    "bot": "demonstrations",
    "write": "writing datasets",
    "videos": "decoding a recording's videos (records one first)",
    "cameras": "a training step on two cameras, long episodes, against ACT's, and acting at 30 Hz",
    "open": "opening a large dataset (writes 2 GB to a temporary folder, takes some minutes)",
}
"""Parts of the table, in its order; `benchmarks.<part>` has a function `rows(options)`."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, print, keep and compare; returns the exit code: 0, 1 for bad input, 2 for bad usage, 130 for Ctrl-C."""
    parser = _parser()
    options = parser.parse_args(arguments)
    unknown = [part for part in options.parts if part not in PARTS]
    if unknown:
        parser.error(f"no part is called {unknown[0]}: choose of {', '.join(PARTS)}")
    return exit_code(lambda: _run(options))


def _run(options: argparse.Namespace) -> None:
    rows = [row for path in options.rows for row in load(path)] if options.rows else measured(options)
    print(as_markdown(rows))
    print(f"\n{details(rows)}")
    if options.json and not options.rows:  # a joined file would claim one commit and one load for all
        save(rows, options.json)
    if options.compare:
        print(f"\n{comparison(rows, options.compare)}")


def measured(options: argparse.Namespace) -> list[Row]:
    """Rows of the chosen parts."""
    import datasets
    import torch

    datasets.disable_progress_bars()
    torch.set_num_threads(options.threads)
    if not (options.root / "meta/info.json").is_file():
        raise UserError(f"--root {options.root}: no dataset; make it with the command in `python -m benchmarks --help`")
    rows: list[Row] = []
    for part in options.parts or PARTS:
        found = importlib.import_module(f"benchmarks.{part}").rows(options)
        print(*as_markdown(found).splitlines()[-len(found) :], sep="\n", file=sys.stderr)
        rows += found
    return rows


def _parser() -> argparse.ArgumentParser:
    parts = "\n".join(f"  {name:<10}{text}" for name, text in PARTS.items())
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks",
        description=__doc__,
        epilog=f"parts:\n{parts}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("parts", nargs="*", metavar="part", help="default: all")
    parser.add_argument("--root", type=Path, default=Path("data/gotoseq_1k"), help="a GoToSeq dataset")
    parser.add_argument("--repo-id", default="local/babyai_gotoseq_1k", help="its name")
    parser.add_argument("--repeats", type=int, default=5, help="of each measurement (default: 5)")
    parser.add_argument("--threads", type=int, default=1, help="of torch (default: 1)")
    parser.add_argument("--check", type=int, default=0, metavar="N", help="part bot: compare N episodes of each level")
    parser.add_argument("--json", type=Path, help="keep the figures here")
    parser.add_argument("--compare", type=Path, nargs="+", help="print how figures changed since these files of --json")
    parser.add_argument("--rows", type=Path, nargs="+", help="take figures from these files of --json, measure nothing")
    return parser


if __name__ == "__main__":
    sys.exit(main())
