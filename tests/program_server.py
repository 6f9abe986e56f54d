"""What `programs` forks: imports LeRobot, then becomes a program for each line of its input, in a fork of itself."""

import gc
import json
import os
import resource
import runpy
import sys
import sysconfig
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

READY = (
    *(f"lerobot.scripts.lerobot_{program}" for program in ("train", "eval", "rollout", "edit_dataset")),
    "matplotlib.pyplot", "scipy.stats", "sklearn",
)  # fmt: skip
"""Nothing of ours: that LeRobot finds this plugin, and what that imports, is left to every program."""


def serve() -> dict[str, Any]:
    """Start a program for each line; a fork returns, with what it is to become."""
    for line in iter(sys.stdin.readline, ""):
        if os.fork() == 0:
            wanted = json.loads(line)
            watch(Path(wanted["folder"]))
            return wanted
        with suppress(ChildProcessError):  # those who have watched a program to its end
            while os.waitpid(-1, os.WNOHANG) != (0, 0):
                pass
    sys.exit()


def watch(folder: Path) -> None:
    """Fork: the fork returns, while this process says how it has ended."""
    program = os.fork()
    if program:
        say(folder / "pid", program)
        _, status = os.waitpid(program, 0)
        say(folder / "code", os.waitstatus_to_exitcode(status))
        os._exit(0)


def say(path: Path, number: int) -> None:
    """Write a file that is there when it is whole."""
    path.with_suffix(".partial").write_text(str(number))
    path.with_suffix(".partial").rename(path)


def settle(wanted: dict[str, Any]) -> None:
    """Take over streams, environment and folder."""
    if wanted["new_session"]:
        os.setsid()
    for number, path in enumerate((os.devnull, *(f"{wanted['folder']}/{name}" for name in ("stdout", "stderr")))):
        file = os.open(path, os.O_RDWR | os.O_CREAT)
        os.dup2(file, number)
        os.close(file)
    os.environ.clear()
    os.environ.update(wanted["env"])
    os.chdir(wanted["cwd"])
    if wanted["file_size"]:
        resource.setrlimit(resource.RLIMIT_FSIZE, (wanted["file_size"],) * 2)


def become(program: str, *arguments: str) -> None:
    """Run an installed script, or what follows `python`, as the main program."""
    more = [path for path in os.environ.get("PYTHONPATH", "").split(os.pathsep) if path]
    sys.path[:1] = ["", *more]  # instead of this file's folder
    if program != "python":
        path = str(Path(sysconfig.get_path("scripts")) / program)
        sys.argv = [path, *arguments]
        runpy.run_path(path, run_name="__main__")
    elif arguments[0] == "-m":
        sys.argv = list(arguments[1:])
        runpy.run_module(arguments[1], run_name="__main__", alter_sys=True)
    elif arguments[0] == "-c":
        sys.argv = ["-c", *arguments[2:]]
        main = sys.modules["__main__"] = ModuleType("__main__")
        exec(arguments[1], main.__dict__)
    else:
        sys.argv = list(arguments)
        sys.path[0] = str(Path(arguments[0]).parent)
        runpy.run_path(arguments[0], run_name="__main__")


if __name__ == "__main__":
    for module in READY:
        import_module(module)
    gc.freeze()  # forks share what is there
    wanted = serve()
    settle(wanted)
    become(*wanted["command"])
