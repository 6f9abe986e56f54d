"""What the command lines of all data sets share: exit codes, checks of the output, the closing lines."""

import argparse
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from dataset_converters.staging import refuse_existing
from lerobot_lisa.errors import UserError, exit_code

if TYPE_CHECKING:
    from dataset_converters.writer import DatasetTotals


def run_command(
    parser: argparse.ArgumentParser, arguments: Sequence[str] | None, extra: str, optional: Sequence[str]
) -> int:
    """Run the command that `parser` finds, a function in `run`, and return the exit code.

    Args:
        parser: each of its commands sets `run`.
        arguments: of the command line; None takes the program's own.
        extra: the extra of the distribution that installs what the commands need.
        optional: the modules of that extra.

    Returns:
        0, 1 for bad input, 130 for Ctrl-C; bad usage ends the program with 2.
    """
    options = parser.parse_args(arguments)

    def work() -> None:
        try:
            options.run(options)
        except ModuleNotFoundError as error:
            if error.name not in optional:
                raise
            raise UserError(f'{error.name} is missing: pip install "lerobot_policy_lisa[{extra}]"') from error

    return exit_code(work, interrupted="interrupted; run the same command again to go on")


def add_output_options(command: argparse.ArgumentParser, example: str) -> None:
    """Add --root and --repo-id; `example` is a dataset's name."""
    command.add_argument("--root", required=True, type=Path, help="directory to create")
    command.add_argument("--repo-id", required=True, help=f"name of the dataset, such as {example}")


def check_output(options: argparse.Namespace) -> None:
    """Raise `UserError` if there is something at --root, or if --repo-id is not user/name."""
    refuse_existing(options.root)
    check_repo_id(options.repo_id)


def check_repo_id(repo_id: str) -> None:
    """Raise `UserError` for a name that no dataset on the Hub can have; folders are named after it."""
    from huggingface_hub.errors import HFValidationError  # slower to import than the rest of this file
    from huggingface_hub.utils import validate_repo_id

    try:
        validate_repo_id(repo_id)
        if repo_id.count("/") == 1:
            return
    except HFValidationError:
        pass
    raise UserError(f"--repo-id {repo_id!r} must look like user/name: letters, digits, dashes, dots, underscores")


def print_summary(
    options: argparse.Namespace, totals: "DatasetTotals", origin: str, seconds: float, settings: Sequence[str] = ()
) -> None:
    """Say what was made, and what to type next; `settings` are options that training on it needs."""
    train = ["lerobot-train", "--policy.type=lisa", f"--dataset.repo_id={options.repo_id}"]
    train += [f"--dataset.root={options.root}", "--policy.push_to_hub=false", *settings]
    train += [f"--output_dir=outputs/{options.repo_id.split('/')[1]}"]
    print(
        f"{totals.episodes:,} episodes, {totals.frames:,} frames, {totals.tasks:,} distinct instructions "
        f"({origin}) in {seconds:.1f} s -> {options.root}\nnext: {shlex.join(train)}"
    )
