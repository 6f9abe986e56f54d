"""The episode store holds what LeRobot's own loader gives, value for value, whatever the files look like."""

import errno
import json
import shutil
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import tiny_datasets
import torch
from filelock import FileLock
from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata
from lerobot.datasets.dataset_tools import delete_episodes
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.datasets.sampler import EpisodeAwareSampler
from torch import Tensor

from dataset_converters.writer import DatasetLayout, Episode, write_dataset
from lerobot_lisa.episodes import load
from lerobot_lisa.episodes.load import load_episodes
from lerobot_lisa.episodes.store import EpisodeStore
from lerobot_lisa.errors import UserError


def open_meta(root: Path) -> LeRobotDatasetMetadata:
    return LeRobotDatasetMetadata("local/tiny", root=root)


def feature_keys(meta: LeRobotDatasetMetadata) -> list[str]:
    return [key for key in meta.features if key.startswith(("observation", "action"))]


def lerobot_windows(root: Path, keys: list[str]) -> list[dict[str, Tensor]]:
    """Every whole episode as one window of LeRobot's `delta_timestamps`."""
    meta = open_meta(root)
    starts = list(meta.episodes["dataset_from_index"])
    lengths = [stop - start for start, stop in zip(starts, meta.episodes["dataset_to_index"], strict=True)]
    deltas = {key: [step / meta.fps for step in range(max(lengths))] for key in keys}
    dataset = LeRobotDataset("local/tiny", root=root, delta_timestamps=deltas)
    windows = []
    for start, length in zip(starts, lengths, strict=True):
        item = dataset[start]
        assert item["action_is_pad"].sum() == max(lengths) - length
        windows.append({key: item[key][:length] for key in keys})
    return windows


def assert_same_as_lerobot(root: Path, location: str = "memory") -> None:
    meta = open_meta(root)
    keys = feature_keys(meta)
    store, windows = load_episodes(meta, keys, location), lerobot_windows(root, keys)
    for episode, window in enumerate(windows):
        columns, packing = store.gather(torch.tensor([episode]))
        for key in keys:
            feature, ours, theirs = meta.features[key], columns[key], window[key]
            picture = feature["dtype"] == "image"
            assert ours.dtype == (torch.uint8 if picture else getattr(torch, feature["dtype"]))
            ours = ours.float() / 255 if picture else ours
            assert torch.equal(ours.to(theirs.dtype).reshape(theirs.shape), theirs), (episode, key)
            assert packing.lengths.tolist() == [len(theirs)]


@pytest.mark.parametrize("location", ["memory", "disk"])
@pytest.mark.parametrize("kind", ["symbolic", "continuous", "pictures"])
def test_same_as_lerobots_windows(kind: str, location: str, request: pytest.FixtureRequest) -> None:
    assert_same_as_lerobot(request.getfixturevalue(kind), location)


def test_several_data_files(tmp_path: Path) -> None:
    """Incompressible frames of 16 kB, so that LeRobot's smallest file limit, 1 MB, is passed."""
    rng = np.random.default_rng(0)
    noise = {"dtype": "float32", "shape": (4096,), "names": None}
    features = {"observation.state": noise, "action": tiny_datasets.CLASSES}
    episodes = [
        Episode("go", {"observation.state": rng.random((n, 4096), dtype=np.float32), "action": rng.integers(0, 7, n)})
        for n in [60, 30, 1, 50]
    ]
    write_dataset(tmp_path / "data", DatasetLayout("local/tiny", 10, features, data_files_size_in_mb=1), episodes)

    assert len(list((tmp_path / "data").rglob("data/**/*.parquet"))) > 1
    assert_same_as_lerobot(tmp_path / "data")


def test_after_lerobot_has_deleted_episodes(symbolic: Path, tmp_path: Path) -> None:
    edited = delete_episodes(
        LeRobotDataset("local/tiny", root=symbolic), [1, 3], output_dir=tmp_path / "edited", repo_id="local/tiny"
    )
    assert edited.meta.total_episodes == 4

    assert_same_as_lerobot(edited.root)
    kept = load_episodes(open_meta(edited.root), ["action"]).gather(torch.arange(4)).columns["action"]
    before = load_episodes(open_meta(symbolic), ["action"]).gather(torch.tensor([0, 2, 4, 5])).columns["action"]
    assert torch.equal(kept, before)


def test_episodes_in_any_order_and_repeated(symbolic: Path) -> None:
    store = load_episodes(open_meta(symbolic), ["observation.grid", "action"])

    columns, packing = store.gather(torch.tensor([4, 1, 4]))

    once, _ = store.gather(torch.tensor([4]))
    assert packing.lengths.tolist() == [23, 1, 23]
    assert torch.equal(columns["observation.grid"][:23], once["observation.grid"])
    assert torch.equal(columns["observation.grid"][24:], once["observation.grid"])


def test_what_is_gathered_is_a_copy(symbolic: Path) -> None:
    store = load_episodes(open_meta(symbolic), ["observation.grid"])
    first, _ = store.gather(torch.tensor([0]))
    expected = first["observation.grid"].clone()

    first["observation.grid"].zero_()

    assert torch.equal(store.gather(torch.tensor([0])).columns["observation.grid"], expected)


def copied(root: Path, to: Path) -> Path:
    shutil.copytree(root, to)
    return to


def folders(home: Path) -> set[Path]:
    return {path for path in (home / "lisa_episode_store").glob("*") if path.is_dir()}


def test_disk_reads_once_until_the_files_change(
    continuous: Path, tmp_path: Path, lerobot_home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    root, before = copied(continuous, tmp_path / "data"), folders(lerobot_home)
    keys = feature_keys(open_meta(root))
    first = load_episodes(open_meta(root), keys, "disk")
    (made,) = folders(lerobot_home) - before
    written = {path: path.stat().st_mtime_ns for path in made.iterdir()}

    again = load_episodes(open_meta(root), keys, "disk")

    assert folders(lerobot_home) - before == {made}
    assert {path: path.stat().st_mtime_ns for path in made.iterdir()} == written
    assert all(torch.equal(first.columns[key], again.columns[key]) for key in keys)
    again.columns["action"].fill_(7)  # copy on write
    assert torch.equal(load_episodes(open_meta(root), keys, "disk").columns["action"], first.columns["action"])

    info = json.loads((root / "meta/info.json").read_text())
    (root / "meta/info.json").write_text(json.dumps(info, indent=8))
    load_episodes(open_meta(root), keys, "disk")
    (changed,) = folders(lerobot_home) - before  # what the files were before has gone
    assert changed != made
    load_episodes(open_meta(root), ["action"], "disk")
    assert len(folders(lerobot_home) - before) == 2
    assert torch.equal(
        first.columns["action"], again.columns["action"].zero_() + first.columns["action"]
    )  # still mapped


def test_new_disk_stores_clear_away_what_is_of_no_use(symbolic: Path, tmp_path: Path, lerobot_home: Path) -> None:
    gone, root = copied(symbolic, tmp_path / "gone"), copied(symbolic, tmp_path / "data")
    load_episodes(open_meta(gone), ["action"], "disk")
    home = lerobot_home / "lisa_episode_store"
    foreign, killed, building = home / "foreign", home / "0.killed.partial", home / "0.building.partial"
    for folder in (foreign, killed, building):
        folder.mkdir()
    (killed / "action.npy").touch()
    Path(f"{killed}.lock").touch()
    before = folders(lerobot_home)
    shutil.rmtree(gone)

    with FileLock(f"{building}.lock"):
        load_episodes(open_meta(root), ["action"])
        assert not killed.exists()
        load_episodes(open_meta(root), ["action"], "disk")

    assert {path.name for path in (foreign, building)} <= {path.name for path in folders(lerobot_home)}
    assert not Path(f"{killed}.lock").exists()
    assert len(folders(lerobot_home) - before) == 1
    assert len(before - folders(lerobot_home)) >= 2  # `killed`, and what was made of `gone`
    shutil.rmtree(building)
    shutil.rmtree(foreign)


def test_what_does_not_fit_into_memory_goes_to_disk(
    symbolic: Path, tmp_path: Path, lerobot_home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    root, before = copied(symbolic, tmp_path / "data"), folders(lerobot_home)
    monkeypatch.setattr(load.psutil, "virtual_memory", lambda: SimpleNamespace(available=1000))

    store = load_episodes(open_meta(root), ["observation.grid"])

    assert len(folders(lerobot_home) - before) == 1
    monkeypatch.undo()
    in_memory = load_episodes(open_meta(root), ["observation.grid"])
    assert torch.equal(store.columns["observation.grid"], in_memory.columns["observation.grid"])


@pytest.mark.parametrize("kind", ["numbers", "pictures"])
def test_a_dataset_that_was_fetched_in_part(kind: str, tmp_path: Path) -> None:
    """As `--dataset.episodes` fetches it from the Hub: all metadata, but only the files of the episodes asked for."""
    whole, part = three_files(tmp_path / "whole", kind), tmp_path / "part"
    shutil.copytree(whole, part)
    middle = sorted(part.rglob("data/**/*.parquet"))[1]
    middle.unlink()
    keys = feature_keys(open_meta(whole))
    files = np.asarray(open_meta(whole).episodes["data/file_index"])
    there = torch.from_numpy(np.flatnonzero(files != 1))

    columns, _ = load_episodes(open_meta(part), keys).gather(there)

    expected, _ = load_episodes(open_meta(whole), keys).gather(there)
    assert all(torch.equal(columns[key], expected[key]) for key in keys)
    with pytest.raises(UserError, match="episode 1 is not on disk"):
        load_episodes(open_meta(part), keys).gather(torch.tensor([0, 1]))


def test_a_dataset_without_its_data_files(symbolic: Path, tmp_path: Path) -> None:
    root = copied(symbolic, tmp_path / "data")
    shutil.rmtree(root / "data")
    with pytest.raises(UserError, match="data files is there: fetch it again"):
        load_episodes(LeRobotDatasetMetadata("local/tiny", root=root), ["action"])
    with pytest.raises(UserError, match=r"has no feature `observation.smell`"):
        load_episodes(open_meta(symbolic), ["observation.smell"])


def three_files(root: Path, kind: str) -> Path:
    """Three episodes in three data files, which incompressible frames fill."""
    rng = np.random.default_rng(0)
    noise = {"dtype": "float32", "shape": (8192,), "names": None}
    camera = {"observation.images.front": tiny_datasets.CAMERA} if kind == "pictures" else {}
    features = {"observation.state": noise, **camera, "action": tiny_datasets.CLASSES}

    def frames(n: int) -> dict[str, np.ndarray]:
        pictures = {key: rng.integers(0, 256, (n, 8, 6, 3), dtype=np.uint8) for key in camera}
        state = rng.random((n, 8192), dtype=np.float32)
        return {"observation.state": state, **pictures, "action": rng.integers(0, 7, n)}

    episodes = [Episode("go", frames(n)) for n in (30, 25, 30)]
    write_dataset(root, DatasetLayout("local/tiny", 10, features, data_files_size_in_mb=1), episodes)
    assert len(list(root.rglob("data/**/*.parquet"))) == 3
    return root


def test_an_interrupted_disk_store_is_made_again(
    symbolic: Path, tmp_path: Path, lerobot_home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    root, before = copied(symbolic, tmp_path / "data"), folders(lerobot_home)

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("lerobot_lisa.episodes.load.values", interrupted)
        with pytest.raises(KeyboardInterrupt):
            load_episodes(open_meta(root), ["action"], "disk")
    assert folders(lerobot_home) == before

    assert_same_as_lerobot(root, "disk")


def test_processes_that_make_the_same_disk_store_do_not_meet(
    symbolic: Path, tmp_path: Path, lerobot_home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A second process starts and finishes while the first one is still reading."""
    root, before = copied(symbolic, tmp_path / "data"), folders(lerobot_home)
    values = load.values

    def in_between(*arguments: Any) -> object:
        monkeypatch.setattr(load, "values", values)
        load_episodes(open_meta(root), ["action"], "disk")
        return values(*arguments)

    monkeypatch.setattr(load, "values", in_between)
    store = load_episodes(open_meta(root), ["action"], "disk")

    assert torch.equal(store.columns["action"], load_episodes(open_meta(root), ["action"]).columns["action"])
    assert len(folders(lerobot_home) - before) == 1


def test_missing_frames_are_a_user_error(symbolic: Path, tmp_path: Path) -> None:
    root = copied(symbolic, tmp_path / "data")
    info = json.loads((root / "meta/info.json").read_text())
    for frames, message in [(57, "have 56 frames, but meta/info.json counts 57"), (55, "56 frames.* counts 55")]:
        (root / "meta/info.json").write_text(json.dumps({**info, "total_frames": frames}))
        with pytest.raises(UserError, match=message):
            load_episodes(open_meta(root), ["action"])


def test_device_store_is_the_same(symbolic: Path) -> None:
    store = load_episodes(open_meta(symbolic), ["observation.grid"])
    moved = store.to("cpu")

    assert torch.equal(
        moved.gather(torch.tensor([2])).columns["observation.grid"],
        store.gather(torch.tensor([2])).columns["observation.grid"],
    )


def test_every_frame_weighs_the_same_over_an_epoch(symbolic: Path) -> None:
    """Exact: LeRobot's sampler draws frames, each draws its episode, whose loss is a mean over frames."""
    meta = open_meta(symbolic)
    starts, stops = list(meta.episodes["dataset_from_index"]), list(meta.episodes["dataset_to_index"])
    store: EpisodeStore = load_episodes(meta, ["action"])
    episode_of = [e for e, (a, b) in enumerate(zip(starts, stops, strict=True)) for _ in range(a, b)]
    weight = [Fraction(0)] * meta.total_frames

    for frame in EpisodeAwareSampler(starts, stops, shuffle=True, seed=0):
        _, packing = store.gather(torch.tensor([episode_of[frame]]))
        share = packing.mean(torch.eye(packing.total)[0]).item()  # of one frame in its episode's mean
        for row in range(starts[episode_of[frame]], stops[episode_of[frame]]):
            weight[row] += Fraction(share).limit_denominator(1000)

    assert weight == [1] * meta.total_frames


def test_a_disk_that_is_full_is_told_before_anything_is_read(
    symbolic: Path, lerobot_home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By what the disk says is free, and by what it says when the room is taken."""
    before = folders(lerobot_home)
    for patched in ("shutil.disk_usage", "os.posix_fallocate"):
        with monkeypatch.context() as patch:
            patch.setattr(f"lerobot_lisa.episodes.disk.{patched}", full_disk)
            with pytest.raises(UserError, match=r"cannot keep 0.0 GB .*\(No space left on device\): make room"):
                load_episodes(open_meta(symbolic), ["observation.direction"], "disk")
    assert folders(lerobot_home) == before


def full_disk(*arguments: Any) -> SimpleNamespace:
    if len(arguments) == 1:
        return SimpleNamespace(free=1)
    raise OSError(errno.ENOSPC, "No space left on device")


def test_a_home_that_is_no_folder(symbolic: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "home").write_text("")
    monkeypatch.setattr("lerobot_lisa.episodes.disk.HF_LEROBOT_HOME", tmp_path / "home")
    with pytest.raises(UserError, match=r"cannot keep the episode store there \(Not a directory\).*HF_LEROBOT_HOME"):
        load_episodes(open_meta(symbolic), ["action"], "disk")
    assert load_episodes(open_meta(symbolic), ["action"]).columns["action"].shape == (56, 1)
