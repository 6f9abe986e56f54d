"""Collected data: replayable, the same bytes however they were made, readable by our converter, one line per error."""

import hashlib
import json
import resource
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import programs
import pytest
from filelock import FileLock

if find_spec("mujoco") is None or find_spec("metaworld") is None:
    pytest.skip("LOReL is not installed", allow_module_level=True)

from lerobot.datasets.lerobot_dataset import LeRobotDataset

from dataset_converters.lorel import collect as collect_module
from dataset_converters.lorel import original_writer
from dataset_converters.lorel.cli import main
from dataset_converters.lorel.collect import CollectSettings, Format, collect
from dataset_converters.lorel.convert import ConvertSettings, convert
from dataset_converters.lorel.random_play import play
from dataset_converters.lorel.shards import make_states
from lerobot_lisa.envs.lorel.camera import Camera
from lerobot_lisa.envs.lorel.labels import happened
from lerobot_lisa.envs.lorel.scene import engine
from lerobot_lisa.envs.lorel.simulator import LorelSimulator
from lerobot_lisa.errors import UserError

PROJECT = Path(__file__).parents[3]


@pytest.fixture(scope="module")
def can_draw() -> None:
    try:
        with Camera() as camera:
            camera.frame(np.zeros(15))
    except UserError as error:
        pytest.skip(str(error))


def settings(root: Path, **changes) -> CollectSettings:
    return CollectSettings(**{"episodes": 60, "root": root, "repo_id": "me/play", **changes})


def tree_hash(root: Path) -> dict[str, str]:
    return {
        str(p.relative_to(root)): hashlib.sha256(p.read_bytes()).hexdigest() for p in root.rglob("*") if p.is_file()
    }


def columns(root: Path) -> dict[str, np.ndarray]:
    table = LeRobotDataset("me/play", root=root).hf_dataset.with_format("numpy")[:]
    return {key: np.stack(table[key]).reshape(-1, 20, n) for key, n in (("observation.state", 15), ("action", 5))}


@pytest.fixture(scope="module")
def sixty(tmp_path_factory):
    root = tmp_path_factory.mktemp("collected") / "play"
    return root, collect(settings(root))


def test_episodes_can_be_replayed_and_labels_say_what_happened(sixty):
    root, result = sixty
    dataset, values = LeRobotDataset("me/play", root=root), columns(root)
    assert result.totals.episodes == dataset.num_episodes == 60 - result.dropped
    assert 3 <= result.dropped <= 25  # a fifth of random episodes
    simulator = LorelSimulator()
    seeds = dataset.meta.episodes["seed"]
    assert set(seeds) < set(range(1_000_000, 1_000_060))
    for i, row in enumerate(dataset.meta.episodes):
        state, action, label = values["observation.state"][i], values["action"][i], row["tasks"][0]
        assert sum(label.count(word) for word in ("left", "right", "up", "down", "open", "close")) == len(
            happened(state[0], state[-1])
        )
        assert row["engine"] == engine()
        if i % 12 == 0:
            again = play(simulator, seeds[i])
            assert again.label == label
            assert np.array_equal(again.state, state)
            assert np.array_equal(again.action, action)
            simulator.reset(np.random.default_rng(np.random.SeedSequence(seeds[i]).spawn(3)[0]))
            for t in range(19):
                simulator.step(action[t])
            assert np.array_equal(simulator.state.astype(np.float32), state[19])


def test_actions_are_uniform_and_episodes_differ(sixty):
    values = columns(sixty[0])
    action = values["action"].reshape(-1, 5) / (1, 1, 1, np.pi, 1)
    assert np.abs(action).max() <= 1 + 1e-6
    assert np.abs(action.mean(axis=0)).max() < 4 / np.sqrt(3 * len(action))  # 4 standard errors
    assert np.abs(action.var(axis=0) - 1 / 3).max() < 0.05
    assert len(np.unique(values["observation.state"][:, 0, 9])) == len(values["action"])


def test_metadata(sixty):
    dataset = LeRobotDataset("me/play", root=sixty[0])
    assert dataset.meta.features["observation.state"]["info"] == {"arm": "original"}
    assert dataset.meta.features["action"]["info"] == {"ignored": ["wrist"]}
    assert (dataset.fps, dataset.meta.robot_type) == (80, "sawyer")
    card = (sixty[0] / "README.md").read_text()
    assert "1000000 to 1000059" in card
    assert engine() in card


def test_two_workers_make_the_same_bytes(sixty, tmp_path):
    collect(settings(tmp_path / "play", workers=2))
    assert tree_hash(tmp_path / "play") == tree_hash(sixty[0])


def test_an_interrupted_run_goes_on_and_makes_the_same_bytes(sixty, tmp_path, monkeypatch):
    made = []

    def stop_at_the_second(folder, arm, seeds):
        if made:
            (folder / "states-half.tmp").write_bytes(b"half")
            raise KeyboardInterrupt
        made.append(seeds)
        return make_states(folder, arm, seeds)

    monkeypatch.setattr(collect_module, "make_states", stop_at_the_second)
    with pytest.raises(KeyboardInterrupt):
        collect(settings(tmp_path / "play"))
    (shard,) = (tmp_path / "play.partial/shards").glob("*.npz")
    before = shard.stat().st_mtime_ns
    monkeypatch.setattr(collect_module, "make_states", make_states)
    with pytest.raises(UserError, match="other settings"):
        collect(settings(tmp_path / "play", first_seed=2_000_000))
    assert shard.stat().st_mtime_ns == before
    collect(settings(tmp_path / "play"))
    assert tree_hash(tmp_path / "play") == tree_hash(sixty[0])


def test_the_original_layout_converts_to_what_is_collected_directly(sixty, tmp_path):
    original = tmp_path / "original"
    result = collect(settings(original, format=Format.HDF5))
    assert (result.totals.episodes, result.dropped) == (60, 0)
    assert sorted(path.name for path in original.iterdir()) == ["data.hdf5", "labels.csv"]
    with h5py.File(original / "data.hdf5") as file:
        assert {name: (array.shape, array.dtype, array.chunks) for name, array in file["sim"].items()} == {
            "actions": ((60, 20, 5), np.float32, None),
            "state": ((60, 20, 15), np.float32, None),
        }
    converted = convert(
        ConvertSettings(original / "data.hdf5", original / "labels.csv", tmp_path / "converted", "me/play")
    )
    assert converted.dropped == sixty[1].dropped
    direct, via = columns(sixty[0]), columns(tmp_path / "converted")
    assert all(np.array_equal(direct[key], via[key]) for key in direct)
    tasks = [
        [row["tasks"] for row in LeRobotDataset("me/play", root=root).meta.episodes]
        for root in (sixty[0], tmp_path / "converted")
    ]
    assert tasks[0] == tasks[1]
    collect(settings(tmp_path / "again", format=Format.HDF5))
    assert tree_hash(tmp_path / "again") == tree_hash(original)


@pytest.mark.usefixtures("can_draw")
def test_images_show_the_stored_states_in_both_formats(tmp_path):
    few = {"episodes": 2, "quality": "minimal", "keep_unlabelled": True}
    collect(settings(tmp_path / "direct", **few))
    collect(settings(tmp_path / "original", format=Format.HDF5, **few))
    dataset = LeRobotDataset("me/play", root=tmp_path / "direct")
    assert dataset.meta.features["observation.image"]["info"] == {"quality": "minimal"}
    with Camera("minimal") as camera, h5py.File(tmp_path / "original/data.hdf5") as file:
        assert file["sim"].attrs["image_quality"] == "minimal"
        for frame in (0, 13, 27):
            image = camera.frame(dataset[frame]["observation.state"].numpy())
            stored = dataset[frame]["observation.image"].numpy().transpose(1, 2, 0)
            assert np.array_equal(np.rint(stored * 255), image)
            assert np.array_equal(np.rint(file["sim/ims"][frame // 20, frame % 20] * 255), image)
            assert image.std() > 20


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--first-seed", "1000"], "reserved"),
        (["--episodes", "0"], "must be 1 to"),
        (["--workers", "0"], "at least 1"),
        (["--repo-id", "nobody"], "user/name"),
        (["--arm", "third"], "no arm 'third'"),
        (["--images", "--quality", "best"], "no image quality 'best'"),
        (["--root", "/proc/here/data"], "/proc/here/data: "),
    ],
)
def test_bad_arguments_are_one_line_and_leave_nothing(tmp_path, capsys, arguments, message):
    given = ["--episodes", "5", "--root", str(tmp_path / "d"), "--repo-id", "me/d", "--workers", "1"]
    assert main(["collect", *given, *arguments]) == 1
    error = capsys.readouterr().err
    assert message in error
    assert error.startswith("error: ")
    assert error.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_a_second_process_is_refused(sixty, tmp_path):
    with pytest.raises(UserError, match="left untouched"):
        collect(settings(sixty[0]))
    partial = tmp_path / "play.partial"
    partial.mkdir()
    described = collect_module._described(settings(tmp_path / "play"))
    (partial / "settings.json").write_text(json.dumps(described, indent=2, sort_keys=True))
    with FileLock(partial / "lock"), pytest.raises(UserError, match="another process"):
        collect(settings(tmp_path / "play"))
    assert partial.exists()


@pytest.mark.slow
def test_a_full_disk_is_one_line_and_leaves_a_run_that_goes_on(sixty, tmp_path):
    """A limit on the size of files stands in for a full disk: shards fit, the data set does not."""
    command = ["python", "-m", "dataset_converters.lorel", "collect", "--episodes", "60", "--workers", "1"]
    ran = programs.run(*command, "--root", tmp_path / "play", "--repo-id", "me/play", file_size=60_000)
    assert ran.returncode == 1
    assert ran.stderr.splitlines()[-1].startswith("error: ")
    assert "Traceback" not in ran.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["play.partial"]
    assert len(list((tmp_path / "play.partial/shards").glob("*.npz"))) == 3
    collect(settings(tmp_path / "play"))
    assert tree_hash(tmp_path / "play") == tree_hash(sixty[0])


def test_a_disk_that_fills_up_under_the_original_layout(tmp_path, monkeypatch):
    """The limit comes when HDF5 has laid out the file: it would crash, but it writes no values."""
    lay_out, before = original_writer._lay_out, resource.getrlimit(resource.RLIMIT_FSIZE)

    def lay_out_and_limit(*arguments):
        offsets = lay_out(*arguments)
        resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, before[1]))
        return offsets

    monkeypatch.setattr(original_writer, "_lay_out", lay_out_and_limit)
    try:
        with pytest.raises(UserError, match="run the same command again"):
            collect(settings(tmp_path / "play", format=Format.HDF5))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert sorted(path.name for path in (tmp_path / "play.partial").iterdir() if path.is_dir()) == ["shards"]
    monkeypatch.setattr(original_writer, "_lay_out", lay_out)
    collect(settings(tmp_path / "play", format=Format.HDF5))
    with h5py.File(tmp_path / "play/data.hdf5") as file:
        assert np.array_equal(file["sim/state"][37], play(LorelSimulator(), 1_000_037).state)


def test_no_room_for_the_original_layout(tmp_path, monkeypatch):
    monkeypatch.setattr(original_writer.shutil, "disk_usage", lambda _: SimpleNamespace(free=1000))
    with pytest.raises(UserError, match="No space left on device; free some space and run the same command again"):
        collect(settings(tmp_path / "play", format=Format.HDF5, episodes=2))
