"""Converted files: every episode comes back, unlabelled ones are dropped and counted, and LeRobot's tools agree."""

import tempfile
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lerobot.datasets.aggregate import aggregate_datasets
from lerobot.datasets.dataset_tools import delete_episodes
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.scripts.lerobot_dataset_viz import get_feature_names
from lerobot.utils.feature_utils import dataset_to_policy_features
from lorel_files import LABELS, original_arrays, write_original

from dataset_converters.lorel.cli import main
from dataset_converters.lorel.convert import ConvertSettings, convert
from dataset_converters.lorel.episode import is_labelled
from dataset_converters.lorel.labels_csv import read_labels, write_labels

REAL = Path(__file__).parents[4] / "shared/data/lorel"


def columns(dataset: LeRobotDataset) -> dict[str, np.ndarray]:
    table = dataset.hf_dataset.with_format("numpy")[:]
    return {key: np.stack(table[key]) for key in ("observation.state", "action")}


@pytest.fixture
def source(tmp_path) -> tuple[Path, Path]:
    return write_original(tmp_path / "source", original_arrays(19, frames=3))


def test_every_labelled_episode_comes_back_with_its_images(source, tmp_path):
    result = convert(ConvertSettings(*source, tmp_path / "d", "me/d", images=True))
    dataset = LeRobotDataset("me/d", root=tmp_path / "d")
    arrays = original_arrays(19, frames=3)
    kept = [i for i in range(19) if LABELS[i % 4] != "do nothing"]
    assert (result.dropped, dataset.num_episodes) == (5, 14) == (19 - len(kept), result.totals.episodes)
    assert dataset.meta.episodes["source_index"] == kept
    assert [row["tasks"] for row in dataset.meta.episodes] == [[LABELS[i % 4]] for i in kept]
    assert np.array_equal(columns(dataset)["observation.state"], arrays["state"][kept].reshape(-1, 15))
    assert np.array_equal(columns(dataset)["action"], arrays["actions"][kept].reshape(-1, 5))
    for frame in (0, 20, 41):  # (3, 64, 64) in [0, 1]
        image = dataset[frame]["observation.image"].numpy().transpose(1, 2, 0)
        assert np.array_equal(image, arrays["ims"][kept][frame // 3, frame % 3])
    card = (tmp_path / "d/README.md").read_text()
    assert "nothing happened:** 5" in card
    assert "data.hdf5" in card


def test_limit_and_unlabelled_episodes(source, tmp_path):
    result = convert(ConvertSettings(*source, tmp_path / "d", "me/d", limit=6, keep_unlabelled=True))
    dataset = LeRobotDataset("me/d", root=tmp_path / "d")
    assert result.dropped == 0
    assert dataset.meta.episodes["source_index"] == [0, 1, 2, 3, 4, 5]
    assert "do nothing" in dataset.meta.tasks.index
    assert "observation.image" not in dataset.meta.features


@pytest.mark.parametrize(
    ("label", "kept"), [("do nothing", False), ("nan", False), ("wave to me", False), ("open drawer", True)]
)
def test_labels_that_say_nothing(label, kept):
    assert is_labelled(label) == kept


def test_metadata_survives_lerobots_tools(source, tmp_path):
    for name in ("a", "b"):
        convert(ConvertSettings(*source, tmp_path / name, f"me/{name}", images=True, limit=3))
    aggregate_datasets(["me/a", "me/b"], "me/both", roots=[tmp_path / "a", tmp_path / "b"], aggr_root=tmp_path / "both")
    both = LeRobotDataset("me/both", root=tmp_path / "both")
    fewer = delete_episodes(both, [0], output_dir=tmp_path / "fewer", repo_id="me/fewer")
    for dataset in (both, fewer):
        assert dataset.meta.features["action"]["info"] == {"ignored": ["wrist"]}
        assert dataset.meta.features["observation.image"]["info"] == {"quality": "full"}
        assert dataset.meta.robot_type == "sawyer"
        assert get_feature_names(dataset, "action") == ["x", "y", "z", "wrist", "gripper"]
        shapes = {key: feature.shape for key, feature in dataset_to_policy_features(dataset.meta.features).items()}
        assert shapes == {"observation.state": (15,), "observation.image": (3, 64, 64), "action": (5,)}
    assert both.meta.episodes["source_index"] == [0, 2, 0, 2]
    assert fewer.num_episodes == 3


def test_images_of_another_quality_are_not_merged(source, tmp_path):
    with h5py.File(source[0], "r+") as file:
        file["sim"].attrs["image_quality"] = "minimal"
    convert(ConvertSettings(*source, tmp_path / "a", "me/a", images=True, limit=3))
    assert LeRobotDataset("me/a", root=tmp_path / "a").meta.features["observation.image"]["info"] == {
        "quality": "minimal"
    }
    with h5py.File(source[0], "r+") as file:
        del file["sim"].attrs["image_quality"]
    convert(ConvertSettings(*source, tmp_path / "b", "me/b", images=True, limit=3))
    with pytest.raises(ValueError, match="features"):
        aggregate_datasets(["me/a", "me/b"], "me/c", roots=[tmp_path / "a", tmp_path / "b"], aggr_root=tmp_path / "c")


@given(
    episodes=st.integers(1, 40),
    frames=st.integers(1, 5),
    seed=st.integers(0, 2**16),
    chunked=st.booleans(),
    labels=st.lists(st.sampled_from(LABELS), min_size=40, max_size=40),
)
@settings(max_examples=8, deadline=None)
def test_round_trip(episodes, frames, seed, chunked, labels):
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        arrays = original_arrays(episodes, frames, seed)
        del arrays["ims"]
        data, table = write_original(folder / "source", arrays, labels[:episodes])
        if chunked:
            with h5py.File(data, "w") as file:
                for key, values in arrays.items():
                    file.create_dataset(f"sim/{key}", data=values, chunks=(1, 1, 5), compression="gzip")
        convert(ConvertSettings(data, table, folder / "d", "me/d", keep_unlabelled=True))
        dataset = LeRobotDataset("me/d", root=folder / "d")
        assert np.array_equal(columns(dataset)["observation.state"], arrays["state"].reshape(-1, 15))
        assert np.array_equal(columns(dataset)["action"], arrays["actions"].reshape(-1, 5))
        assert [row["tasks"] for row in dataset.meta.episodes] == [[label] for label in labels[:episodes]]


@given(st.lists(st.text(st.characters(codec="utf-8", exclude_categories=("C", "Z")), min_size=1)))
@settings(max_examples=30, deadline=None)
def test_labels_round_trip(labels):
    with tempfile.TemporaryDirectory() as name:
        write_labels(Path(name) / "labels.csv", labels)
        assert read_labels(Path(name) / "labels.csv") == labels


@pytest.mark.skipif(not REAL.is_dir(), reason="the sample of the original data set is not here")
def test_the_sample_of_the_original_files(tmp_path, capsys):
    arguments = [str(REAL / "data.hdf5"), str(REAL / "labels.csv"), "--root", str(tmp_path / "d"), "--images"]
    assert main(["convert", *arguments, "--repo-id", "me/d", "--limit", "6"]) == 0
    assert "1 episodes left out" in capsys.readouterr().out
    dataset = LeRobotDataset("me/d", root=tmp_path / "d")
    assert dataset.meta.episodes["source_index"] == [0, 2, 3, 4, 5]
    assert dataset[0]["task"] == "move white mug right and move black mug down and left"
    with h5py.File(REAL / "data.hdf5") as file:
        state, image = file["sim/state"][2, 7], file["sim/ims"][2, 7]
    assert np.array_equal(dataset[27]["observation.state"].numpy(), state)
    assert np.abs(dataset[27]["observation.image"].numpy().transpose(1, 2, 0) - image).max() < 1e-6
