"""Runs steps in order, several at a time, on this machine.

doit does it: it is small, pure Python, can be called from a program, and knows what needs what, what is up to date, and
how to go on beside a failure. Snakemake brings a language, a solver and dozens of dependencies; DVC wants a git
repository and its own cache around every result; Hydra starts many runs but does not know which are done.
"""

import sys
import tempfile
import threading
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from lerobot_lisa.errors import UserError
from lerobot_lisa.reproduce.perform import end_programs, perform
from lerobot_lisa.reproduce.steps import Step


def run_here(steps: Sequence[Step], jobs: int) -> list[str]:
    """Perform steps and what they need, those first that come first.

    Args:
        steps: Which.
        jobs: How many at a time.

    Returns:
        What went wrong, a line for each step that failed; what does not need it has run all the same.
    """
    from doit.control import TaskControl  # an extra, which lists and published numbers do without
    from doit.dependency import Dependency, JsonDB
    from doit.runner import MThreadRunner, Runner
    from doit.task import Stream, dict_to_task

    failures: list[str] = []
    whole = {step.name: step for last in steps for step in last.chain()}
    control = TaskControl([dict_to_task(_task(step, failures)) for step in whole.values()])
    control.process([step.name for step in steps])
    with tempfile.TemporaryDirectory() as folder:  # doit's database, which notes beside results make needless
        state = Dependency(JsonDB, str(Path(folder) / "doit.json"))
        runner = MThreadRunner if jobs > 1 else Runner
        more = {"num_process": jobs} if jobs > 1 else {}
        try:
            runner(state, _Quiet(), continue_=True, stream=Stream(0), **more).run_all(control.task_dispatcher())
        except BaseException:
            end_programs()  # those of doit's threads, which get no Ctrl-C
            raise
    return failures


def _task(step: Step, failures: list[str]) -> dict[str, Any]:
    """A step as doit wants it."""

    def work() -> bool:
        try:
            perform(step, _say)
        except UserError as error:
            failures.append(str(error))
            return False
        except OSError as error:
            failures.append(f"{step.label}: {error.filename or step.folder}: {error.strerror or error}")
            return False
        return True

    return {
        "name": step.name,
        "actions": [(work,)],
        "task_dep": [needed.name for needed in step.after],
        "uptodate": [lambda: step.note is not None],
        "io": {"capture": False},
    }


_SPEAKING = threading.Lock()


def _say(line: str) -> None:
    with _SPEAKING:
        print(line, flush=True)


class _Quiet:
    """doit reports to nobody: steps speak for themselves."""

    def __getattr__(self, name: str) -> Any:
        return lambda *_: None


def in_order(steps: Iterable[Step]) -> list[Step]:
    """The quickest first: something to look at soon, and what takes a night last."""
    return sorted(steps, key=lambda step: sum(needed.seconds for needed in step.chain()))


def say_failures(failures: Sequence[str]) -> None:
    """All but the last of several, which ends the program."""
    for failure in failures[:-1]:
        print(f"error: {failure}", file=sys.stderr)
    if failures:
        raise UserError(failures[-1])
