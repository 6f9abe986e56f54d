"""Declare that what has changed in the code since a commit changes no result, so that no row becomes stale by it.

python -m lerobot_lisa.reproduce.declare dea56fa "finite scalars can be built without memory; nothing else reads this"

It adds each changed and each new file to lerobot_lisa/same_results.json. One more change of the file, and rows that use
it are stale again; a file that is gone makes them stale whatever is declared. docs/reproduce.md says how to see first
that it is true.
"""

import argparse
import json
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence

from lerobot_lisa.analysis.files import write_json
from lerobot_lisa.code_version import PACKAGE, SAME_RESULTS, meaning
from lerobot_lisa.errors import UserError, exit_code

_CHECKOUT = PACKAGE.parent


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("commit", help="the last one whose results are known")
    parser.add_argument("why", help="why results are the same, and what showed it")
    parser.add_argument("files", nargs="*", help="only these (default: all that have changed)")
    parser.add_argument("--unless", help="but results may change where this is set, such as policy.termination_stride")
    options = parser.parse_args(arguments)
    said = {"why": options.why, **({"unless": options.unless} if options.unless else {})}
    return exit_code(lambda: _declare(options.commit, options.files, said))


def _declare(commit: str, files: Sequence[str], said: Mapping[str, str]) -> None:
    known = json.loads(SAME_RESULTS.read_text(encoding="utf-8"))
    declared = {change["is"] for change in known}
    new = [change for change in _changes(commit, files) if change["is"] not in declared]
    if not new:
        raise UserError(f"since {commit} no code has changed that is not declared yet")
    write_json([*known, *({**change, **said} for change in new)], SAME_RESULTS, indent=2)
    print(*(f"declared: {change['file']}" for change in new), sep="\n")


def _changes(commit: str, files: Sequence[str]) -> Iterator[dict[str, str]]:
    """Files of code that mean something else than at a commit; what is new has meant nothing."""
    where = files or ("lerobot_lisa", "dataset_converters")
    for line in _git("diff", "--name-status", "--no-renames", "--diff-filter=AM", commit, "--", *where).splitlines():
        status, file = line.split("\t")
        if not file.endswith(".py"):
            continue
        was = "" if status == "A" else meaning(_git("show", f"{commit}:{file}").encode())
        if was != (now := meaning((_CHECKOUT / file).read_bytes())):
            yield {"file": file, "was": was, "is": now}


def _git(*arguments: str) -> str:
    told = subprocess.run(["git", "-C", str(_CHECKOUT), *arguments], capture_output=True, text=True, check=False)
    if told.returncode:
        raise UserError(f"git {arguments[0]}: {told.stderr.strip().splitlines()[0]}")
    return told.stdout


if __name__ == "__main__":
    sys.exit(main())
