"""The command line of the BabyAI datasets: generate, convert, levels."""

import argparse
import os
import time
from collections.abc import Sequence
from pathlib import Path

from dataset_converters.babyai.encodings import CellEncoding
from dataset_converters.commands import add_output_options, check_output, print_summary, run_command


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code: 0, 1 for bad input, 2 for bad usage, 130 for Ctrl-C."""
    return run_command(_parser(), arguments, extra="babyai", optional=("minigrid", "blosc"))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m dataset_converters.babyai", description=__doc__)
    commands = parser.add_subparsers(required=True, metavar="command")

    generate = commands.add_parser("generate", help="let the bot demonstrate a level")
    generate.add_argument("--level", required=True, help="such as GoToSeq; the command `levels` lists all")
    generate.add_argument("--episodes", required=True, type=int, help="successful episodes to keep")
    generate.add_argument("--first-seed", type=int, default=1_000_000, help="default 1000000; below is for evaluation")
    generate.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="processes (default: all cores)")
    generate.add_argument("--subtasks", action="store_true", help="store which part of the instruction the bot serves")
    generate.set_defaults(run=_generate)

    convert = commands.add_parser("convert", help="convert a demonstration file of the original BabyAI package")
    convert.add_argument("source", type=Path, help="such as BabyAI-GoToSeq-v0.pkl")
    convert.add_argument("--level", help="default: from the file's name")
    convert.add_argument("--limit", type=int, help="number of demonstrations (default: all)")
    convert.add_argument("--subset-seed", type=int, help="draw the --limit demonstrations as the LISA paper does")
    encodings = [encoding.value for encoding in CellEncoding if encoding is not CellEncoding.A]
    convert.add_argument("--cell-encoding", choices=["auto", *encodings], default="auto", help="default: detected")
    convert.set_defaults(run=_convert)

    for command in (generate, convert):
        add_output_options(command, "me/babyai_gotoseq_1k")
    commands.add_parser("levels", help="list the levels").set_defaults(run=_levels)
    return parser


def _generate(options: argparse.Namespace) -> None:
    from lerobot_lisa.envs.babyai.levels import check_level

    check_output(options)
    check_level(options.level)  # before the seconds that importing LeRobot takes
    from dataset_converters.babyai.generate import GenerateSettings, generate

    started = time.monotonic()
    result = generate(
        GenerateSettings(
            options.level, options.episodes, options.root, options.repo_id, options.first_seed, options.workers,
            options.subtasks,
        )
    )  # fmt: skip
    from dataset_converters.seeds import describe_seeds

    seeds = f"seeds {describe_seeds(options.first_seed, result.seeds)}"
    print_summary(options, result.totals, seeds, time.monotonic() - started)


def _convert(options: argparse.Namespace) -> None:
    check_output(options)
    from dataset_converters.babyai.convert import ConvertSettings, convert

    started = time.monotonic()
    encoding = None if options.cell_encoding == "auto" else CellEncoding(options.cell_encoding)
    totals = convert(
        ConvertSettings(
            options.source, options.root, options.repo_id, options.level, options.limit, options.subset_seed, encoding
        )
    )
    print_summary(options, totals, f"from {options.source}", time.monotonic() - started)


def _levels(options: argparse.Namespace) -> None:
    from lerobot_lisa.envs.babyai.levels import level_names

    print(*level_names(), sep="\n")
