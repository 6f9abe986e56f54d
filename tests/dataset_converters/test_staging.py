"""A dataset appears as a whole or not at all: killed before any of its file-system calls, a run can be made again."""

import hashlib
import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from filelock import FileLock

from dataset_converters.staging import staged
from lerobot_lisa.errors import UserError

SETTINGS = {"level": "GoToLocal"}
CHANGES = {"open", "os.mkdir", "os.rename", "os.remove", "os.rmdir", "shutil.rmtree", "os.listdir", "os.scandir"}
WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT


def build(root: Path, settings: dict = SETTINGS) -> None:
    """What converters do: a shard that is kept, and a dataset of it."""
    with staged(root, settings) as partial:
        (partial / "shards").mkdir(exist_ok=True)
        (partial / "shards/0").write_text("shard")
        (partial / "dataset/meta").mkdir(parents=True)
        (partial / "dataset/meta/info.json").write_text("{}")


def contents(folder: Path) -> dict[str, str]:
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else "folder"
        for path in folder.rglob("*")
    }


def killed(run: Callable[[], object], root: Path, before: int) -> bool:
    """Run in a process that is killed before its n-th change of files at or beside `root`; whether there were so many.

    The command's output is thrown away.
    """
    child = os.fork()
    if child == 0:
        seen = 0

        def watch(event: str, arguments: tuple) -> None:
            nonlocal seen
            if event not in CHANGES or not arguments or not isinstance(arguments[0], (str, os.PathLike)):
                return
            reading = event == "open" and not (arguments[2] & WRITING)
            if not reading and os.path.abspath(arguments[0]).startswith(str(root)):  # noqa: PTH100
                seen += 1
                if seen == before:
                    os.kill(os.getpid(), signal.SIGKILL)

        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        os.dup2(1, 2)
        sys.addaudithook(watch)
        code = 1
        try:
            run()
            code = 0
        finally:
            os._exit(code)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    assert code in (0, -signal.SIGKILL)
    return code != 0


def check_every_kill_point(run: Callable[[Path], object], folder: Path) -> int:
    """Kill before every change in turn, run again, and find what an undisturbed run makes; returns their number."""
    run(folder / "undisturbed")
    point = 1
    while True:
        home = folder / str(point)
        root = home / "data"
        home.mkdir()
        if not killed(lambda root=root: run(root), root, before=point):
            return point - 1
        if root.exists():
            assert [path.name for path in home.iterdir()] == ["data"]
        else:
            run(root)
        assert [path.name for path in home.iterdir()] == ["data"]
        assert contents(root) == contents(folder / "undisturbed")
        point += 1


pytestmark = pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")


def test_a_run_that_is_killed_anywhere_can_be_made_again(tmp_path: Path) -> None:
    assert check_every_kill_point(build, tmp_path) > 10


@pytest.mark.slow
@pytest.mark.parametrize("command", ["generate", "convert"])
def test_a_command_that_is_killed_anywhere_can_be_run_again(command: str, tmp_path: Path, capfd) -> None:
    pytest.importorskip("blosc")
    from dataset_converters.babyai.cli import main

    given = {
        "generate": ["--level", "GoToLocal", "--episodes", "3", "--workers", "1"],
        "convert": [str(Path(__file__).parents[3] / "shared/data/babyai/BabyAI-GoToSeq-v0_valid.pkl"), "--limit", "3"],
    }[command]
    if command == "convert" and not Path(given[0]).exists():
        pytest.skip("the sample of the original data set is not here")

    def run(root: Path) -> None:
        assert main([command, *given, "--root", str(root), "--repo-id", "me/d"]) == 0

    assert check_every_kill_point(run, tmp_path) >= 25


def test_what_is_not_ours_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "a.partial").write_text("a file")
    (tmp_path / "b.partial").mkdir()
    (tmp_path / "b.partial/precious").touch()
    for name in "ab":
        with pytest.raises(UserError, match="not made by this program"):
            build(tmp_path / name)
    build(tmp_path / "c")
    with pytest.raises(UserError, match="left untouched"):
        build(tmp_path / "c")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.partial", "b.partial", "c"]


def test_a_dataset_that_appears_meanwhile_is_left_alone(tmp_path: Path) -> None:
    def build_late() -> None:
        with staged(tmp_path / "d", SETTINGS) as partial:
            (partial / "dataset").mkdir()
            (tmp_path / "d").mkdir()

    with pytest.raises(UserError, match="left untouched"):
        build_late()
    assert [path.name for path in tmp_path.iterdir()] == ["d"]


def test_shards_survive_a_failure_and_wait_for_the_same_settings(tmp_path: Path) -> None:
    partial = tmp_path / "d.partial"

    def fail() -> None:
        with staged(tmp_path / "d", SETTINGS):
            (partial / "shards").mkdir()
            (partial / "shards/0").touch()
            (partial / "dataset").mkdir()
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    with pytest.raises(UserError, match="other settings"):
        build(tmp_path / "d", {"level": "GoTo"})
    with FileLock(partial / "lock"), pytest.raises(UserError, match="another process"):
        build(tmp_path / "d")
    assert sorted(contents(partial)) == ["lock", "settings.json", "shards", "shards/0"]
    build(tmp_path / "d")
    assert [path.name for path in tmp_path.iterdir()] == ["d"]
