"""Keeps a run that was made by hand among the files of docs/results; `lisa-reproduce --publish` keeps those of rows.

python -m benchmarks.results add outputs/heard/lisa_0/heard.json --row="GoToLocal 1k" --seed=0 --commit=150f7f8
python -m benchmarks.results render

`add` keeps of what `lisa-diagnose heard` wrote the numbers and how they came about, without this machine's paths.
`render` is `lisa-reproduce --render`; a test sees to it that the tables are what the files say.
"""

import argparse
import json
import re
import sys
from collections.abc import Sequence
from pathlib import Path

from lerobot_lisa.errors import UserError, exit_code
from lerobot_lisa.reproduce.outcomes import how_evaluated
from lerobot_lisa.reproduce.results import FOLDER, render_page, shorten


def add(path: Path, row: str, seed: int, commit: str, note: str) -> Path:
    """Keep a run.

    Raises:
        UserError: The file is not what `lisa-diagnose heard` writes.
    """
    try:
        told = json.loads(path.read_text(encoding="utf-8"))
        made = told.get("made", {})
        run = {
            "row": row,
            "policy": told["evaluation"]["policy"]["type"],
            "seed": seed,
            "commit": commit,
            "note": note,
            **how_evaluated(told),
            "rates": told["rates"]["overall"],
            "commits": {"train": commit, "heard": made.get("commit")},
            "commands": {"heard": shorten(made.get("command", ""))},
        }
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise UserError(f"{path}: not a heard.json of `lisa-diagnose heard` ({error!r:.80})") from error
    limit = run["env"]["max_episode_steps"]
    name = f"{row} {run['policy']} seed{seed} {'own_limit' if limit is None else f'limit{limit}'}"
    target = FOLDER / run["env"]["type"] / f"{re.sub(r'[^a-z0-9_]+', '_', name.lower())}.json"
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(json.dumps(run, indent=2) + "\n", encoding="utf-8")
    return target


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    adding = commands.add_parser("add", help="keep a run")
    adding.add_argument("file", type=Path, help="heard.json of `lisa-diagnose heard`")
    adding.add_argument("--row", required=True, help='level and demonstrations, such as "GoToSeq 1k"')
    adding.add_argument("--seed", type=int, required=True, help="of the training")
    adding.add_argument("--commit", required=True, help="that trained")
    adding.add_argument("--note", default="", help="what else a reader should know")
    commands.add_parser("render", help="write the tables anew")
    options = parser.parse_args(arguments)
    if options.command == "add":
        return exit_code(lambda: print(add(options.file, options.row, options.seed, options.commit, options.note)))
    return exit_code(lambda: render_page(Path()))


if __name__ == "__main__":
    sys.exit(main())
