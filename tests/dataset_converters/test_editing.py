"""LeRobot's own editing commands on our datasets: what they keep, and the columns that they drop."""

import json
import os
import subprocess
import sys
import sysconfig
from pathlib import Path

import numpy as np
import programs
import pytest
from lerobot.datasets.lerobot_dataset import LeRobotDataset

from dataset_converters.babyai.schema import FEATURES as BABYAI_FEATURES
from dataset_converters.lorel.schema import EPISODE_COLUMNS, lorel_layout
from dataset_converters.writer import DatasetLayout, Episode, write_dataset

pytestmark = pytest.mark.slow
SCRIPTS = Path(sysconfig.get_path("scripts"))


def edit(*arguments: object) -> None:
    done = programs.run("lerobot-edit-dataset", *arguments)
    assert done.returncode == 0, done.stderr


def write(root: Path, layout: DatasetLayout, episodes: int = 4, frames: int = 3) -> LeRobotDataset:
    """A dataset with these features, episodes numbered in `seed`."""
    rng = np.random.default_rng(0)

    def column(feature: dict) -> np.ndarray:
        shape = (frames, *feature["shape"])
        if feature["dtype"].startswith("float"):
            return rng.normal(size=shape).astype(feature["dtype"])
        return rng.integers(0, 4, shape).astype("uint8" if feature["dtype"] == "image" else feature["dtype"])

    made = (
        Episode(f"task {i % 3}", {key: column(ft) for key, ft in layout.features.items()}, {"seed": 1_000_000 + i})
        for i in range(episodes)
    )
    write_dataset(root, layout, made)
    return LeRobotDataset(layout.repo_id, root=root)


def facts(dataset: LeRobotDataset) -> dict:
    """What must survive of the features."""
    return {key: (ft["names"], ft.get("info")) for key, ft in dataset.meta.features.items() if key in LOREL.features}


LOREL = lorel_layout("me/lorel", "minimal", "original")


def test_splitting_images(tmp_path: Path) -> None:
    whole = write(tmp_path / "lorel", LOREL)
    splits = json.dumps({"train": 0.5, "val": 0.5})
    edit(
        "--repo_id=me/lorel", f"--root={tmp_path}/lorel", f"--new_root={tmp_path}/parts", "--operation.type=split",
        f"--operation.splits={splits}",
    )  # fmt: skip
    for number, name in enumerate(("train", "val")):
        part = LeRobotDataset(f"me/lorel_{name}", root=tmp_path / "parts" / name)
        assert (part.num_episodes, facts(part)) == (2, facts(whole))
        for i in range(len(part)):
            for key in ("observation.image", "observation.state", "action", "task"):
                assert np.array_equal(part[i][key], whole[6 * number + i][key])
        assert not EPISODE_COLUMNS.keys() & set(part.meta.episodes.column_names)  # LeRobot drops them


def test_deleting_and_merging(tmp_path: Path) -> None:
    whole = write(tmp_path / "babyai", DatasetLayout("me/babyai", 10, BABYAI_FEATURES, EPISODE_COLUMNS))
    edit(
        "--repo_id=me/babyai", f"--root={tmp_path}/babyai", "--new_repo_id=me/fewer", f"--new_root={tmp_path}/fewer",
        "--operation.type=delete_episodes", "--operation.episode_indices=[1]",
    )  # fmt: skip
    fewer = LeRobotDataset("me/fewer", root=tmp_path / "fewer")
    assert [row["tasks"] for row in fewer.meta.episodes] == [["task 0"], ["task 2"], ["task 0"]]
    assert fewer.meta.features["action"]["names"] == whole.meta.features["action"]["names"]
    assert "seed" not in fewer.meta.episodes.column_names
    edit(
        "--new_repo_id=me/twice", f"--new_root={tmp_path}/twice", "--operation.type=merge",
        "--operation.repo_ids=['me/babyai','me/babyai']",
        f"--operation.roots=['{tmp_path}/babyai','{tmp_path}/babyai']",
    )  # fmt: skip
    twice = LeRobotDataset("me/twice", root=tmp_path / "twice")
    assert list(twice.meta.episodes["seed"]) == [*whole.meta.episodes["seed"], *whole.meta.episodes["seed"]]
    assert (twice.num_episodes, len(twice.meta.tasks)) == (8, 3)


def test_looking_at_an_episode(tmp_path: Path) -> None:
    """`lerobot-dataset-viz` without a screen; it needs `pip install "lerobot[viz]"`."""
    pytest.importorskip("rerun")
    write(tmp_path / "lorel", LOREL)
    command = [sys.executable, SCRIPTS / "lerobot-dataset-viz", "--repo-id=me/lorel", f"--root={tmp_path}/lorel"]
    command += ["--episode-index=2", "--save=1", f"--output-dir={tmp_path}"]
    env = {**os.environ, "HF_HUB_OFFLINE": "1", "PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run(command, env=env, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "me_lorel_episode_2.rrd").stat().st_size > 1000
