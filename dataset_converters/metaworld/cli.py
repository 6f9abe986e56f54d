"""The command line of the Meta-World datasets: collect, tasks."""

import argparse
import os
import time
from collections.abc import Sequence

from dataset_converters.commands import add_output_options, check_output, print_summary, run_command


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code: 0, 1 for bad input, 2 for bad usage, 130 for Ctrl-C."""
    return run_command(_parser(), arguments, extra="metaworld", optional=("mujoco", "metaworld"))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m dataset_converters.metaworld", description=__doc__)
    commands = parser.add_subparsers(required=True, metavar="command")

    collect = commands.add_parser("collect", help="let the package's scripted experts demonstrate tasks")
    named = "MT10, MT25, MT50, easy, medium, hard, very_hard, or names such as reach-v3, separated by commas"
    collect.add_argument("--tasks", required=True, help=named)
    collect.add_argument("--episodes", required=True, type=int, help="successful episodes to keep of each task")
    pictures = collect.add_mutually_exclusive_group()
    small = "pixels along each side of pictures, made smaller as our policies do (default: the environment's 480)"
    pictures.add_argument("--image-size", type=int, help=small)
    pictures.add_argument("--states-only", action="store_true", help="no pictures: the hand's place and the gripper")
    collect.add_argument("--first-seed", type=int, default=1_000_000, help="default 1000000; below is for evaluation")
    collect.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="processes (default: all cores)")
    add_output_options(collect, "me/mt10")
    collect.set_defaults(run=_collect)

    commands.add_parser("tasks", help="list the tasks and their instructions").set_defaults(run=_tasks)
    return parser


def _collect(options: argparse.Namespace) -> None:
    check_output(options)
    from lerobot_lisa.envs.metaworld_states.tasks import find_tasks

    tasks = find_tasks(options.tasks, "--tasks")
    from dataset_converters.metaworld.cards import seeds_by_task
    from dataset_converters.metaworld.collect import CollectSettings, collect

    started = time.monotonic()
    settings = CollectSettings(
        tasks=tasks,
        episodes=options.episodes,
        root=options.root,
        repo_id=options.repo_id,
        pictures=not options.states_only,
        image_size=options.image_size,
        first_seed=options.first_seed,
        workers=options.workers,
    )
    result = collect(settings)
    print(*seeds_by_task(result.seeds, settings.first_seed), sep="\n")
    origin = f"{len(tasks)} tasks, {result.failures:,} failures of the experts left out"
    size = [f"--policy.image_size={settings.image_size}"] if settings.image_size else []
    print_summary(options, result.totals, origin, time.monotonic() - started, size)


def _tasks(options: argparse.Namespace) -> None:
    from lerobot_lisa.envs.metaworld_states.tasks import instructions

    for task, instruction in instructions().items():
        print(f"{task:30}{instruction}")
