"""The command line of runs on many processes or machines: generate, convert, collect."""

import argparse
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from dataset_converters.commands import add_output_options, check_repo_id, run_command
from dataset_converters.seeds import check_run
from lerobot_lisa.errors import UserError

if TYPE_CHECKING:
    from dataset_converters.cluster.plan import Plan


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code: 0, 1 for bad input, 2 for bad usage, 130 for Ctrl-C."""
    modules = ("datatrove", "minigrid", "blosc", "mujoco", "metaworld")
    return run_command(_parser(), arguments, extra="scale,babyai,lorel", optional=modules)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m dataset_converters.cluster", description=__doc__)
    commands = parser.add_subparsers(required=True, metavar="command")

    generate = commands.add_parser("generate", help="bot demonstrations of a BabyAI level, in shards of seeds")
    generate.add_argument("--level", required=True, help="such as GoToSeq")
    generate.set_defaults(plan=_generate_plan)

    convert = commands.add_parser("convert", help="files of the original BabyAI package, one to a shard")
    convert.add_argument("sources", type=Path, nargs="+", help="files of one level, in order")
    convert.add_argument("--level", required=True, help="such as GoToSeq")
    convert.set_defaults(plan=_convert_plan)

    collect = commands.add_parser("collect", help="random play of LOReL, in shards of seeds")
    collect.add_argument("--quality", help="render images: minimal, smooth or full (default: states only)")
    collect.set_defaults(plan=_collect_plan)

    for command in (generate, collect):
        command.add_argument("--episodes", required=True, type=int, help="of the whole dataset")
        command.add_argument("--per-shard", type=int, default=5000, help="seeds to a shard (default 5000)")
        command.add_argument("--first-seed", type=int, default=1_000_000, help="default 1000000")
    for command in (generate, convert, collect):
        _add_common_options(command)
    return parser


def _add_common_options(command: argparse.ArgumentParser) -> None:
    add_output_options(command, "me/babyai_gotoseq_1m")
    command.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="shards at a time")
    command.add_argument("--executor", choices=["local", "slurm"], default="local", help="where (default: here)")
    command.add_argument("--partition", help="of SLURM")
    command.add_argument("--time", default="08:00:00", help="limit of a SLURM job (default 08:00:00)")
    command.add_argument("--memory", type=int, default=4, help="GB for a SLURM job (default 4)")
    command.add_argument("--qos", default="", help="of SLURM")
    command.set_defaults(run=_run)


def _run(options: argparse.Namespace) -> None:
    check_repo_id(options.repo_id)
    if options.executor == "slurm":
        if not options.partition:
            raise UserError("--executor=slurm needs --partition, the SLURM partition to run on")
        from dataset_converters.cluster.slurm import Slurm, slurm_executor  # only this needs datatrove
    from dataset_converters.cluster.steps import prepare, run_here

    plan: Plan = options.plan(options)
    prepare(plan)
    if options.executor == "local":
        run_here(plan, options.workers)
        print(f"{plan.shards} shards merged -> {plan.root}")
        return
    slurm = Slurm(options.partition, options.time, options.memory, options.qos)
    slurm_executor(plan, options.workers, slurm).run()
    print(f"{plan.shards} shards and their merge are in the queue; logs: {plan.logs}, then the dataset: {plan.root}")


def _generate_plan(options: argparse.Namespace) -> "Plan":
    from lerobot_lisa.envs.babyai.levels import check_level

    _check_ranges(options)
    level = check_level(options.level)
    from dataset_converters.cluster.babyai import GeneratePlan

    root = options.root.absolute()
    return GeneratePlan(root, options.repo_id, level, options.episodes, options.per_shard, options.first_seed)


def _convert_plan(options: argparse.Namespace) -> "Plan":
    from lerobot_lisa.envs.babyai.levels import check_level

    missing = [source for source in options.sources if not source.is_file()]
    if missing:
        raise UserError(f"{missing[0]}: there is no such file")
    level = check_level(options.level)
    from dataset_converters.cluster.babyai import ConvertPlan

    sources = tuple(source.absolute() for source in options.sources)
    return ConvertPlan(options.root.absolute(), options.repo_id, level, sources)


def _collect_plan(options: argparse.Namespace) -> "Plan":
    _check_ranges(options)
    from dataset_converters.cluster.lorel import CollectPlan
    from dataset_converters.lorel.collect import CollectSettings

    root = options.root.absolute()
    settings = CollectSettings(
        options.episodes, root, options.repo_id, quality=options.quality, first_seed=options.first_seed
    )
    return CollectPlan(root, options.repo_id, settings, options.per_shard)


def _check_ranges(options: argparse.Namespace) -> None:
    check_run(options.episodes, options.workers, options.first_seed)
    if options.per_shard < 1:
        raise UserError("--per-shard must be at least 1")
