"""Performs one step: its command runs in the step's folder, and what it says goes into a log there."""

import os
import re
import shlex
import shutil
import subprocess
import sys
import sysconfig
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import FileLock, Timeout

from lerobot_lisa.code_version import commit
from lerobot_lisa.errors import UserError
from lerobot_lisa.reproduce.steps import Step

LOG, _LOCK, _SPENT = "log.txt", "lock", "seconds"
_PROGRESS = re.compile(r"\bstep:\S+ .*")  # of what LeRobot logs, the lines about training
_UNDER_WAY: list["subprocess.Popen[str]"] = []
_SECONDS_TO_END = 20  # for a program that is asked to: a checkpoint may be under way


def perform(step: Step, say: Callable[[str], None] = print) -> None:
    """Do what is left of a step; whatever ends it, the next call goes on where the program can.

    Raises:
        UserError: Another process performs it, its command failed, or a step that it needs is not done.
    """
    if missing := [needed for needed in step.after if needed.note is None]:
        raise UserError(f"{step.label}: {missing[0].kind} is missing, which has failed: see {missing[0].folder / LOG}")
    with _claimed(step), _clock(step.folder / _SPENT) as seconds:
        if step.note is not None:
            return
        if not (step.folder / step.result).exists():
            _clear(step)
            _run(step, say)
        step.write_note(commit(), seconds())


@contextmanager
def _claimed(step: Step) -> Iterator[None]:
    """Keep a step for one process at a time."""
    step.folder.mkdir(parents=True, exist_ok=True)
    try:
        with FileLock(step.folder / _LOCK, timeout=0):
            yield
    except Timeout:
        raise UserError(f"{step.label}: another process is at work in {step.folder}: wait for it") from None


@contextmanager
def _clock(path: Path) -> Iterator[Callable[[], float]]:
    """How long this step has taken, all calls together."""
    before, started = 0.0, time.monotonic()
    with suppress(OSError, ValueError):
        before = float(path.read_text())

    def spent() -> float:
        return before + time.monotonic() - started

    try:
        yield spent
    finally:
        path.write_text(f"{spent():.1f}")


def _clear(step: Step) -> None:
    """LeRobot refuses a folder of a training that was interrupted before its first checkpoint; nothing is lost."""
    if step.going_on and not (step.folder / step.going_on).is_file():
        shutil.rmtree(step.folder / Path(step.going_on).parts[0], ignore_errors=True)


def _run(step: Step, say: Callable[[str], None]) -> None:
    command = step.next_command
    say(f"$ {shlex.join(command)}")
    log, last = step.folder / LOG, ""
    with log.open("a", encoding="utf-8") as file:
        file.write(f"$ {shlex.join(command)}\n")
        with _started(command) as process:
            for line in process.stdout or ():  # universal newlines: a progress bar's states are lines too
                file.write(line)
                last = line.strip() or last
                if progress := _PROGRESS.search(line):
                    say(f"[{step.label}] {progress[0]}")
    if process.returncode or not (step.folder / step.result).exists():
        raise UserError(
            f"{step.label}: `{command[0]}` ended with exit code {process.returncode}: {last:.300} (all of it: {log})"
        )


@contextmanager
def _started(command: list[str]) -> Iterator[subprocess.Popen[str]]:
    """A program that ends with this block, whatever ends the block."""
    process: subprocess.Popen[str] = subprocess.Popen(
        _executable(command),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
        env={"OMP_NUM_THREADS": "1", **os.environ},  # a network of this size gains nothing from threads
    )
    _UNDER_WAY.append(process)
    try:
        yield process
        process.wait()
    finally:
        _end(process)
        _UNDER_WAY.remove(process)
        if process.stdout:
            process.stdout.close()


def end_programs() -> None:
    """End all programs that were started here."""
    for process in list(_UNDER_WAY):
        _end(process)


def _end(process: "subprocess.Popen[str]") -> None:
    if process.poll() is None:
        process.terminate()
        with suppress(subprocess.TimeoutExpired):
            process.wait(_SECONDS_TO_END)
        process.kill()
        process.wait()


def _executable(command: list[str]) -> list[str]:
    """The command with its program's full path, so that it is this environment's."""
    program, *arguments = command
    path = sys.executable if program == "python" else str(Path(sysconfig.get_path("scripts")) / program)
    return [path, *arguments]
