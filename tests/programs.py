"""Programs in processes of their own that need not import PyTorch and LeRobot again: forks of one that has.

Importing both takes six seconds of a core, which is most of what a small command costs. A fork has nothing else that is
ready: it runs the installed script, or what `python` was told to, in the environment and the folder that it is given.
But strings have the same hashes in all forks, so whether processes agree is also asked of some that start from nothing,
as one run of every command does.
"""

import json
import os
import signal
import subprocess
import sys
import sysconfig
import tempfile
import time
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

_SERVER = Path(__file__).with_name("program_server.py")
_READ_BY_IMPORTS = "HF_"  # a server for each Hub and home: LeRobot looks at these once
_FOLDER = tempfile.TemporaryDirectory(prefix="programs_")


class Program:
    """A program that runs; as far as it goes, what `subprocess.Popen` is.

    Attributes:
        pid: Its process, which is no child of this one.
    """

    def __init__(self, command: list[str], **wanted: Any) -> None:
        self.args = command
        self._folder = Path(tempfile.mkdtemp(dir=_FOLDER.name))
        self._server = _server(tuple(item for item in wanted["env"].items() if item[0].startswith(_READ_BY_IMPORTS)))
        line = json.dumps({"command": command, "folder": str(self._folder), **wanted})
        print(line, file=self._server.stdin, flush=True)
        self.pid = self._await("pid")

    def poll(self) -> int | None:
        """Its exit code, or the signal that ended it, below 0; None: it runs."""
        path = self._folder / "code"
        return int(path.read_text()) if path.exists() else None

    @property
    def returncode(self) -> int | None:
        """See `poll`."""
        return self.poll()

    def wait(self) -> int:
        """Its exit code, when it has ended."""
        return self._await("code")

    def communicate(self) -> tuple[str, str]:
        """What it has printed, when it has ended."""
        self.wait()
        stdout, stderr = ((self._folder / name).read_text() for name in ("stdout", "stderr"))
        return stdout, stderr

    def send_signal(self, number: int) -> None:
        """To this process only."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        """End it at once."""
        self.send_signal(signal.SIGKILL)

    def _await(self, name: str) -> int:
        path = self._folder / name
        while not path.exists():
            assert self._server.poll() is None, "what was to be forked has ended"
            time.sleep(0.005)
        return int(path.read_text())


def start(
    program: str,
    *arguments: object,
    cwd: Path | None = None,
    env: Mapping[str, str] | None = None,
    file_size: int | None = None,
    new_session: bool = False,
) -> Program:
    """Start a command.

    Args:
        program: An installed script by its name, or "python" with a script, `-m` or `-c`.
        arguments: Of the program.
        cwd: Its folder; None: this one.
        env: Its environment; None: this one.
        file_size: Bytes that its files may have, as on a disk without room; None: any number.
        new_session: Whether it and its children get a session of their own.
    """
    environment = {"OMP_NUM_THREADS": "1", **(os.environ if env is None else env)}
    command = [program, *map(str, arguments)]
    more = {"file_size": file_size, "new_session": new_session}
    return Program(command, cwd=str(cwd or Path.cwd()), env=environment, **more)


def run(program: str, *arguments: object, **settings: Any) -> subprocess.CompletedProcess[str]:
    """Start a command, see `start`, and wait for its end."""
    started = start(program, *arguments, **settings)
    return subprocess.CompletedProcess(started.args, started.wait(), *started.communicate())


def run_anew(
    program: str, *arguments: object, cwd: Path | None = None, env: Mapping[str, str] | None = None
) -> subprocess.CompletedProcess[str]:
    """Run an installed script in a process that starts from nothing."""
    command = [Path(sysconfig.get_path("scripts")) / program, *map(str, arguments)]
    environment = {"OMP_NUM_THREADS": "1", **(os.environ if env is None else env)}
    return subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, check=False)


@cache
def _server(of_hugging_face: tuple[tuple[str, str], ...]) -> "subprocess.Popen[str]":
    """Ends with this process, when its input does."""
    others = {name: value for name, value in os.environ.items() if not name.startswith(_READ_BY_IMPORTS)}
    environment = {**others, **dict(of_hugging_face), "OMP_NUM_THREADS": "1"}
    streams = {"stdin": subprocess.PIPE, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    return subprocess.Popen([sys.executable, _SERVER], text=True, env=environment, **streams)
