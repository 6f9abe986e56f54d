"""Damaged and hostile files: one clear line, exit code 1, nothing left, nothing outside the file read."""

from pathlib import Path

import h5py
import numpy as np
import pytest
from lorel_files import original_arrays, write_original

from dataset_converters.lorel.cli import main


@pytest.fixture
def source(tmp_path) -> tuple[Path, Path]:
    return write_original(tmp_path / "source", original_arrays(3, frames=2))


def refused(source: tuple[Path, Path], tmp_path: Path, capsys, *extra: str) -> str:
    """The one line about files that are refused; checks that nothing is left."""
    arguments = [*map(str, source), "--root", str(tmp_path / "d"), "--repo-id", "me/d"]
    assert main(["convert", *arguments, *extra]) == 1
    error = capsys.readouterr().err
    assert error.startswith("error: ")
    assert error.count("\n") == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["source"]
    return error


@pytest.mark.parametrize("keep", [0, 7, 100, 900, 0.5, -1])
def test_a_truncated_file(source, tmp_path, capsys, keep):
    whole = source[0].read_bytes()
    source[0].write_bytes(whole[: int(len(whole) * keep) if isinstance(keep, float) else keep])
    assert "data.hdf5" in refused(source, tmp_path, capsys, "--images")


@pytest.mark.parametrize("seed", range(20))
def test_a_damaged_header(source, tmp_path, capsys, seed):
    """Random bytes anywhere in the file's structure: refused in one line, or harmless."""
    raw = bytearray(source[0].read_bytes())
    rng = np.random.default_rng(seed)
    for at in rng.integers(0, 2048, 40):
        raw[at] = rng.integers(256)
    source[0].write_bytes(raw)
    code = main(["convert", *map(str, source), "--root", str(tmp_path / "d"), "--repo-id", "me/d"])
    error = capsys.readouterr().err
    assert code == 0 or (error.startswith("error: ") and error.count("\n") == 1 and not (tmp_path / "d").exists())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda a: a.pop("state"), "has no sim/state"),
        (lambda a: a.pop("actions"), "has no sim/actions"),
        (lambda a: a.pop("ims"), "has no sim/ims"),
        (lambda a: a.clear(), "has no sim"),
        (lambda a: a.update(state=a["state"][0]), "expected float32 (episodes, frames, 15)"),
        (lambda a: a.update(state=a["state"].astype(np.float64)), "float64"),
        (lambda a: a.update(actions=a["actions"].astype(np.int32)), "int32"),
        (lambda a: a.update(actions=a["actions"][..., :4]), "(3, 2, 4)"),
        (lambda a: a.update(actions=np.array(["open"] * 3, dtype="S")), "|S4"),
        (lambda a: a.update(state=a["state"][:0]), "needs episodes"),
        (lambda a: a.update(actions=a["actions"][:2]), "half written"),
        (lambda a: a.update(actions=a["actions"][:, :1]), "half written"),
        (lambda a: a["state"].__setitem__((1, 0, 3), np.nan), "sim/state of episode 1 holds a value that is NaN"),
        (lambda a: a["actions"].__setitem__((2, 1, 0), np.inf), "sim/actions of episode 2"),
        (lambda a: a["ims"].__setitem__((1, 0, 3), np.nan), "sim/ims of episode 1"),
        (lambda a: a["ims"].__setitem__((1, 0, 3), 1.5), "outside [0, 1]"),
        (lambda a: a["state"].__setitem__(2, 0), "sim/state of episode 2 is all zeros; the file is only half written"),
        (lambda a: a["ims"].__setitem__(0, 0), "sim/ims of episode 0 is all zeros"),
    ],
)
def test_wrong_arrays(tmp_path, capsys, change, message):
    arrays = original_arrays(3, frames=2)
    change(arrays)
    source = write_original(tmp_path / "source", arrays, ["open drawer"] * 3)
    assert message in refused(source, tmp_path, capsys, "--images")


def external_group(file: h5py.File, other: Path) -> None:
    del file["sim"]
    file["sim"] = h5py.ExternalLink(other.name, "sim")


def external_array(file: h5py.File, other: Path) -> None:
    del file["sim/state"]
    file["sim/state"] = h5py.ExternalLink(str(other), "sim/state")


def soft_link_to_an_external_link(file: h5py.File, other: Path) -> None:
    external_array(file, other)
    file["hidden"] = file.get("sim/state", getlink=True)
    del file["sim/state"]
    file["sim/state"] = h5py.SoftLink("/hidden")


def virtual_array(file: h5py.File, other: Path) -> None:
    del file["sim/state"]
    layout = h5py.VirtualLayout((3, 2, 15), np.float32)
    layout[:] = h5py.VirtualSource(str(other), "sim/state", (3, 2, 15))
    file["sim"].create_virtual_dataset("state", layout)


def raw_file(file: h5py.File, other: Path) -> None:
    del file["sim/state"]
    file["sim"].create_dataset("state", (3, 2, 15), np.float32, external=[(str(other), 0, h5py.h5f.UNLIMITED)])


@pytest.mark.parametrize(
    "hide", [external_group, external_array, soft_link_to_an_external_link, virtual_array, raw_file]
)
def test_nothing_outside_the_file_is_read(source, tmp_path, capsys, hide):
    other = write_original(tmp_path / "source/other", original_arrays(3, frames=2))[0]
    with h5py.File(source[0], "r+") as file:
        hide(file, other)
    assert "refused" in refused(source, tmp_path, capsys)


def test_arrays_that_were_never_written(source, tmp_path, capsys):
    with h5py.File(source[0], "r+") as file:
        del file["sim/state"]
        file["sim"].create_dataset("state", (3, 2, 15), np.float32)
    assert "never written" in refused(source, tmp_path, capsys)


def test_chunks_too_large_for_memory(source, tmp_path, capsys):
    with h5py.File(source[0], "r+") as file:
        del file["sim/state"]
        file["sim"].create_dataset(
            "state", (3, 2, 15), np.float32, maxshape=(None, None, 15), chunks=(10_000, 1000, 15)
        )
    assert "chunks of more than" in refused(source, tmp_path, capsys)


def test_a_group_where_an_array_should_be(source, tmp_path, capsys):
    with h5py.File(source[0], "r+") as file:
        del file["sim/state"]
        file.create_group("sim/state")
    assert "is a Group, not a Dataset" in refused(source, tmp_path, capsys)


@pytest.mark.parametrize(
    ("raw", "message"),
    [
        (b"", "no column 'Episode Number'"),
        (b"Episode Number,Label\n0,open drawer\n", "no column 'Text Description'"),
        (b"Episode Number,Text Description\n0,open drawer\n1,open drawer\n", "has 2 labels"),
        (b"Episode Number,Text Description\n0,a\n1,a\n2,a\n3,a\n", "has 4 labels"),
        (b"Episode Number,Text Description\n0,a\n1, \n2,a\n", "label of episode 1 is ''"),
        (b"Episode Number,Text Description\n0,a\n1,\xff\xfe\n2,a\n", "not UTF-8"),
        (b'Episode Number,Text Description\n0,a\n1,"a\nb"\n2,a\n', "label of episode 1 is 'a\\nb'"),
        (b"Episode Number,Text Description\n0,a\n2,a\n1,a\n", "numbered '2' instead of 1; sort its rows"),
        (
            b"Episode Number,Text Description\n20,a\n21,a\n22,a\n",
            "numbered '20' instead of 0; is it a part of a longer",
        ),
        (b"Episode Number,Text Description\n0,a\n1,a\x1b[31m\n2,a\n", "label of episode 1 is 'a\\x1b[31m'"),
        (b"Episode Number,Text Description\n0,a\n1," + b"x" * 100_000 + b"\n2,a\n", "episode 1 has 100,000 characters"),
        (b"Episode Number,Text Description\n0,a\n1\n2,a\n", "row 2 has 1 fields"),
        (b'Episode Number,Text Description\n0,a\n1,"a\n', "not a CSV file"),
        (b"Episode Number,Text Description\n0,do nothing\n1,nan\n2,wave\n", "no label says that anything happened"),
    ],
)
def test_wrong_labels(source, tmp_path, capsys, raw, message):
    source[1].write_bytes(raw)
    assert message in refused(source, tmp_path, capsys)


def test_missing_files_and_wrong_arguments(source, tmp_path, capsys):
    absent = tmp_path / "source/absent"
    assert "does not exist" in refused((absent, source[1]), tmp_path, capsys)
    assert "No such file" in refused((source[0], absent), tmp_path, capsys)
    assert "must be 1 to 3" in refused(source, tmp_path, capsys, "--limit", "4")
    assert "must be 1 to 3" in refused(source, tmp_path, capsys, "--limit", "0")
    assert "as HDF5" in refused((source[1], source[1]), tmp_path, capsys)
    assert "user/name" in refused(source, tmp_path, capsys, "--repo-id", "d")
