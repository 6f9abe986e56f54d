"""The real commands under bad luck: killed, out of disk, two at once, damaged files. One line, nothing half left."""

import hashlib
import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path

import programs
import pytest
from lorel_files import original_arrays, write_original

from dataset_converters.lorel.convert import ConvertSettings
from dataset_converters.lorel.convert import convert as make_conversion

if find_spec("mujoco") is None or find_spec("metaworld") is None:
    pytest.skip("LOReL is not installed", allow_module_level=True)

from dataset_converters.lorel.collect import CollectSettings
from dataset_converters.lorel.collect import collect as make_collection

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]  # most of the time is spent importing LeRobot
LOREL = ("python", "-m", "dataset_converters.lorel")


def run(*arguments: object, limit: int | None = None) -> subprocess.CompletedProcess[str]:
    """Run a command; `limit` bounds the size of its files, in bytes, as a full disk would."""
    return programs.run(*LOREL, *arguments, file_size=limit)


def refused(done: subprocess.CompletedProcess[str]) -> str:
    """The one line of a command that ended as it should on bad input."""
    lines = [line for line in done.stderr.splitlines() if line.startswith("error: ")]
    assert (done.returncode, len(lines), done.stdout) == (1, 1, ""), done.stderr
    assert done.stderr.splitlines()[-1] == lines[0]
    assert "Traceback" not in done.stderr
    return lines[0]


def tree_hash(root: Path) -> dict[str, str]:
    return {
        str(p.relative_to(root)): hashlib.sha256(p.read_bytes()).hexdigest() for p in root.rglob("*") if p.is_file()
    }


def stopped(process: programs.Program, ready: Callable[[], bool]) -> programs.Program:
    """The process, halted as soon as it is ready."""
    while not ready():
        assert process.poll() is None, "ended before it was ready"
        time.sleep(0.001)
    os.kill(process.pid, signal.SIGSTOP)
    return process


@pytest.fixture
def play(tmp_path: Path) -> Iterator[Callable[[list[object], Callable[[], bool]], programs.Program]]:
    """Starts commands that are halted half-way; none outlives the test."""
    started: list[programs.Program] = []

    def start(arguments: list[object], ready: Callable[[], bool]) -> programs.Program:
        started.append(programs.start(*LOREL, *arguments))
        return stopped(started[-1], ready)

    yield start
    for process in started:
        process.kill()
        process.wait()


def test_a_second_collection_is_refused_and_a_killed_one_goes_on_to_the_same_bytes(tmp_path, play) -> None:
    root, partial = tmp_path / "play", tmp_path / "play.partial"
    collect = ["collect", "--episodes", 60, "--workers", 1, "--repo-id", "me/play"]
    first = play([*collect, "--root", root], lambda: any(partial.glob("shards/states-*.npz")))
    assert "another process is writing this dataset" in refused(run(*collect, "--root", root))
    assert not root.exists()
    first.kill()
    first.wait()
    kept = {path.name: path.stat().st_mtime_ns for path in partial.glob("shards/states-*.npz")}
    assert 1 <= len(kept) <= 3
    again = run(*collect, "--root", root)
    assert (again.returncode, partial.exists()) == (0, False), again.stderr
    make_collection(CollectSettings(60, tmp_path / "whole", "me/play"))
    assert tree_hash(root) == tree_hash(tmp_path / "whole")


def test_a_second_conversion_is_refused_and_a_killed_one_starts_over_to_the_same_bytes(tmp_path, play) -> None:
    arrays = original_arrays(2000, frames=5)
    del arrays["ims"]
    source = write_original(tmp_path / "source", arrays)
    root, partial = tmp_path / "d", tmp_path / "d.partial"
    convert = ["convert", *source, "--repo-id", "me/d"]
    first = play([*convert, "--root", root], lambda: (partial / "dataset/meta").exists())
    assert "another process is writing this dataset" in refused(run(*convert, "--root", root))
    first.kill()
    first.wait()
    assert partial.exists()
    assert not root.exists()
    again = run(*convert, "--root", root)
    assert (again.returncode, partial.exists()) == (0, False), again.stderr
    make_conversion(ConvertSettings(*source, tmp_path / "whole", "me/d"))
    assert tree_hash(root) == tree_hash(tmp_path / "whole")


def test_a_conversion_without_room(tmp_path) -> None:
    arrays = original_arrays(200)
    del arrays["ims"]
    source = write_original(tmp_path / "source", arrays)
    convert = ["convert", *source, "--root", tmp_path / "d", "--repo-id", "me/d"]
    assert str(tmp_path / "d") in refused(run(*convert, limit=60_000))
    assert [path.name for path in tmp_path.iterdir()] == ["source"]


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 256 KiB, where one may be mounted."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=256k", "tmpfs", str(folder)]
    if os.geteuid() != 0 or subprocess.run(mount, capture_output=True, check=False).returncode != 0:
        pytest.skip("no right to mount a small disk")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


@pytest.mark.parametrize("layout", ["convert", "hdf5"])
def test_a_disk_that_is_really_full(small_disk: Path, tmp_path: Path, layout: str) -> None:
    arrays = original_arrays(400)
    del arrays["ims"]
    source = write_original(tmp_path / "source", arrays)
    made = ["convert", *source] if layout == "convert" else ["collect", "--episodes", 200, "--format", layout]
    more = [] if layout == "convert" else ["--workers", 1]
    line = refused(run(*made, *more, "--root", small_disk / "d", "--repo-id", "me/d"))
    assert "No space left on device; free some space and run the same command again" in line
    left = {path.name for path in small_disk.iterdir()}
    assert left == (set() if layout == "convert" else {"d.partial"})  # shards wait for the next run
    assert [path.name for path in (small_disk / "d.partial").glob("*") if path.is_dir()] == ["shards"] * len(left)


def truncated(data: Path, labels: Path) -> None:
    data.write_bytes(data.read_bytes()[:-1000])


def not_utf8(data: Path, labels: Path) -> None:
    labels.write_bytes(labels.read_bytes().replace(b"open", b"\xffpen"))


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (truncated, "cannot be read as HDF5"),
        (not_utf8, "labels.csv: is not UTF-8"),
    ],
)
def test_damaged_files(tmp_path, damage, message) -> None:
    """The whole list, without a process for each: test_original_file.py."""
    source = write_original(tmp_path / "source", original_arrays(3, frames=2), ["open drawer"] * 3)
    damage(*source)
    assert message in refused(run("convert", *source, "--images", "--root", tmp_path / "d", "--repo-id", "me/d"))
    assert [path.name for path in tmp_path.iterdir()] == ["source"]
