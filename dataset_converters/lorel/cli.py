"""The command line of the LOReL datasets: convert, collect."""

import argparse
import os
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

    collect = commands.add_parser("collect", help="let our simulator play at random")
    collect.add_argument("--episodes", required=True, type=int, help="episodes to play, one per seed")
    collect.add_argument("--images", action="store_true", help="render images too")
    collect.add_argument("--quality", default="minimal", help="of the images: minimal (default), smooth or full")
    collect.add_argument("--format", choices=["lerobot", "hdf5"], default="lerobot", help="hdf5: as the original data")
    collect.add_argument("--arm", default="original", help="original (default), or free: comparable with nobody's")
    collect.add_argument("--first-seed", type=int, default=1_000_000, help="default 1000000; below is for evaluation")
    collect.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="processes (default: all cores)")
    collect.set_defaults(run=_collect)

    for command in (convert, collect):
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


def _collect(options: argparse.Namespace) -> None:
    check_output(options)
    from lerobot_lisa.envs.lorel.installation import check_installed

    check_installed()
    from dataset_converters.lorel.collect import CollectSettings, Format, collect

    started = time.monotonic()
    settings = CollectSettings(
        episodes=options.episodes,
        root=options.root,
        repo_id=options.repo_id,
        quality=options.quality if options.images else None,
        format=Format(options.format),
        keep_unlabelled=options.keep_unlabelled,
        arm=options.arm,
        first_seed=options.first_seed,
        workers=options.workers,
    )
    result = collect(settings)
    seeds, seconds = f"seeds {settings.seeds.first} to {settings.seeds.stop - 1}", time.monotonic() - started
    if settings.format is Format.HDF5:
        print(f"{result.totals.episodes:,} episodes ({seeds}) in {seconds:.1f} s -> {options.root}")
    else:
        origin = f"{seeds}, {result.dropped:,} episodes left out because nothing happened"
        print_summary(options, result.totals, origin, seconds)
