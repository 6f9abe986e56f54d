"""The command line of the LOReL datasets: convert, collect."""

import argparse
import time
from collections.abc import Sequence
from pathlib import Path

from dataset_converters.commands import add_output_options, check_output, print_summary, run_command


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code: 0, 1 for bad input, 2 for bad usage, 130 for Ctrl-C."""
    return run_command(_parser(), arguments, extra="lorel", optional=("h5py", "mujoco", "metaworld"))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m dataset_converters.lorel", description=__doc__)
    commands = parser.add_subparsers(required=True, metavar="command")

    convert = commands.add_parser("convert", help="convert the original files")
    convert.add_argument("source", type=Path, help="such as data.hdf5")
    convert.add_argument("labels", type=Path, help="such as labels.csv")
    convert.add_argument("--images", action="store_true", help="convert the images too")
    convert.add_argument("--limit", type=int, help="look at the first N episodes of the file (default: all)")
    convert.set_defaults(run=_convert)

    for command in (convert,):
        add_output_options(command, "me/lorel_states")
        unlabelled = "keep episodes in which nothing happened"
        command.add_argument("--keep-unlabelled", action="store_true", help=unlabelled)
    return parser


def _convert(options: argparse.Namespace) -> None:
    check_output(options)
    from dataset_converters.lorel.convert import ConvertSettings, convert

    started = time.monotonic()
    result = convert(
        ConvertSettings(
            options.source,
            options.labels,
            options.root,
            options.repo_id,
            options.images,
            options.limit,
            options.keep_unlabelled,
        )
    )
    origin = f"from {options.source}, {result.dropped:,} episodes left out because nothing happened"
    print_summary(options, result.totals, origin, time.monotonic() - started)
