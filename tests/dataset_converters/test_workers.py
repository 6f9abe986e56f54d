"""Worker processes end with their parent, however it ends."""

import os
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import programs
import psutil
import pytest

pytestmark = pytest.mark.slow  # processes that import LeRobot
PROJECT = Path(__file__).parents[2]
SLEEPERS = """
import sys, time
from pathlib import Path
from dataset_converters.workers import results_in_order, worker_pool
from lerobot_lisa.errors import exit_code

def sleep(name):
    Path(sys.argv[0]).with_name(name).touch()
    time.sleep(900)

def work():
    with worker_pool(2, []) as pool:
        list(results_in_order(pool, sleep, [("one",), ("two",)], ahead=2))

if __name__ == "__main__":
    raise SystemExit(exit_code(work))
"""
Start = Callable[..., programs.Program]


def family(session: int) -> list[str]:
    """Command lines of the processes of a session that are alive."""
    alive = []
    for process in psutil.process_iter():
        try:
            if os.getsid(process.pid) == session and process.status() != psutil.STATUS_ZOMBIE:
                alive.append(" ".join(process.cmdline()))
        except (psutil.NoSuchProcess, ProcessLookupError):
            pass
    return alive


@pytest.fixture
def start() -> Iterator[Start]:
    """Starts programs in sessions of their own; nothing of them outlives the test."""
    started: list[programs.Program] = []

    def run(*arguments: object) -> programs.Program:
        started.append(programs.start("python", *arguments, cwd=PROJECT, new_session=True))
        return started[-1]

    yield run
    for process in started:
        if family(process.pid):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def wait_for(ready: Callable[[], object], seconds: float = 200) -> bool:
    deadline = time.monotonic() + seconds
    while not ready() and time.monotonic() < deadline:
        time.sleep(0.1)
    return bool(ready())


def test_a_second_ctrl_c_ends_the_workers_at_once(start: Start, tmp_path: Path) -> None:
    (tmp_path / "sleepers.py").write_text(SLEEPERS)
    parent = start(tmp_path / "sleepers.py")
    assert wait_for(lambda: all((tmp_path / name).exists() for name in ("one", "two")))
    os.killpg(parent.pid, signal.SIGINT)
    time.sleep(2)
    assert parent.poll() is None  # it waits for what is under way
    os.killpg(parent.pid, signal.SIGINT)
    _, errors = parent.communicate()
    assert parent.returncode == 130
    assert errors.splitlines() == [
        "interrupted: finishing what is under way; Ctrl-C again to end at once",
        "interrupted",
    ]
    assert wait_for(lambda: not family(parent.pid), 30), family(parent.pid)


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_a_run_in_shards_leaves_no_process_behind(start: Start, tmp_path: Path, how: signal.Signals) -> None:
    command = ["generate", "--level", "GoToLocal", "--episodes", 200_000, "--per-shard", 100_000, "--workers", 2]
    parent = start("-m", "dataset_converters.cluster", *command, "--root", tmp_path / "d", "--repo-id", "me/d")
    shards = tmp_path / "d.shards"
    assert wait_for(lambda: len(list(shards.glob("*.partial/shards/*.npz"))) >= 4)
    assert len(family(parent.pid)) >= 4
    parent.send_signal(how)
    _, errors = parent.communicate()
    assert parent.returncode == (130 if how == signal.SIGINT else -how)
    assert "Traceback" not in errors
    assert wait_for(lambda: not family(parent.pid), 30), family(parent.pid)
    assert (shards / "settings.json").is_file()
