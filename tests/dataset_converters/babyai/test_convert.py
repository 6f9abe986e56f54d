"""Converted files: every demonstration comes back, subsets are the paper's, and LeRobot's tools work on the result."""

import pickle
import random
import re
import shlex
from pathlib import Path

import numpy as np
import programs
import pytest
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from original_files import demo, dump, pack

from dataset_converters.babyai.cli import main
from dataset_converters.babyai.convert import ConvertSettings, convert, subset_indices
from lerobot_lisa.errors import UserError

REAL = Path(__file__).parents[4] / "shared/data/babyai/BabyAI-GoToSeq-v0_valid.pkl"


@pytest.fixture
def source(tmp_path) -> Path:
    path = tmp_path / "BabyAI-GoToSeq-v0.pkl"
    path.write_bytes(dump([demo(2 + i % 5, seed=i, mission=f"go to ball {i % 30}") for i in range(40)]))
    return path


def test_every_demonstration_comes_back(source, tmp_path):
    totals = convert(ConvertSettings(source, tmp_path / "d", "me/d"))
    dataset = LeRobotDataset("me/d", root=tmp_path / "d")
    assert (totals.episodes, totals.tasks) == (40, 30) == (dataset.num_episodes, dataset.meta.total_tasks)
    table = dataset.hf_dataset.with_format("numpy")[:]
    for i, row in enumerate(dataset.meta.episodes):
        mission, images, directions, actions = demo(2 + i % 5, seed=i, mission=f"go to ball {i % 30}")
        frames = slice(row["dataset_from_index"], row["dataset_to_index"])
        assert np.array_equal(table["observation.grid"][frames], images.reshape(-1, 147))
        assert table["observation.direction"][frames].tolist() == directions
        assert table["action"][frames].tolist() == actions
        assert (row["tasks"], row["level"], row["seed"], row["source_index"]) == ([mission], "GoToSeq", None, i)
    card = (tmp_path / "d/README.md").read_text()
    assert "BabyAI-GoToSeq-v0.pkl" in card
    assert "bsd-3-clause" in card


def test_a_subset_is_the_papers(source, tmp_path):
    demos = list(range(40))
    random.seed(5)
    random.shuffle(demos)
    convert(ConvertSettings(source, tmp_path / "d", "me/d", limit=7, subset_seed=5))
    chosen = LeRobotDataset("me/d", root=tmp_path / "d").meta.episodes["source_index"]
    assert chosen == sorted(demos[:7]) == subset_indices(40, 7, 5)
    convert(ConvertSettings(source, tmp_path / "e", "me/e", limit=7))
    assert LeRobotDataset("me/e", root=tmp_path / "e").meta.episodes["source_index"] == list(range(7))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"limit": 41}, "more than its 40"),
        ({"limit": 0}, "at least 1"),
        ({"subset_seed": 1}, "needs --limit"),
        ({"level": "Nowhere"}, "no BabyAI level"),
        ({"source": Path("nowhere/BabyAI-GoTo-v0.pkl")}, "cannot be read"),
        ({"source": Path("nowhere/demos.pkl")}, "say --level"),
    ],
)
def test_bad_settings_leave_nothing(source, tmp_path, changes, message):
    with pytest.raises(UserError, match=message):
        convert(ConvertSettings(**{"source": source, "root": tmp_path / "d", "repo_id": "me/d", **changes}))
    assert list(tmp_path.iterdir()) == [source]


def test_a_bad_demonstration_far_into_the_file_leaves_nothing(source, tmp_path, capsys):
    content = source.read_bytes()
    demos = [item for _ in range(40) for item in pickle.loads(content)]
    mission, images, directions, _ = demo(3)
    source.write_bytes(pickle.dumps([*demos, (mission, pack(images), directions, [0, 1, 9])]))
    assert main(["convert", str(source), "--root", str(tmp_path / "d"), "--repo-id", "me/d"]) == 1
    error = capsys.readouterr().err
    assert error == f"error: {source}: demonstration 1600: action is outside 0..6\n"
    assert list(tmp_path.iterdir()) == [source]


def test_the_real_file(tmp_path, capsys):
    if not REAL.exists():
        pytest.skip(f"{REAL.name} is not here")
    assert main(["convert", str(REAL), "--root", str(tmp_path / "d"), "--repo-id", "me/d"]) == 0
    assert "50 episodes, 3,774 frames, " in capsys.readouterr().out


@pytest.mark.slow
def test_lerobots_own_tools_edit_the_dataset(source, tmp_path):
    convert(ConvertSettings(source, tmp_path / "d", "me/d"))

    def edit(*arguments: str) -> str:
        done = programs.run("lerobot-edit-dataset", *arguments)
        assert done.returncode == 0, done.stderr[-2000:]
        return done.stdout + done.stderr

    here = ["--repo_id=me/d", f"--root={tmp_path / 'd'}"]
    assert "40" in edit(*here, "--operation.type=info")
    edit(
        *here, "--operation.type=delete_episodes", "--operation.episode_indices=[0,39]",
        "--new_repo_id=me/fewer", f"--new_root={tmp_path / 'fewer'}",
    )  # fmt: skip
    fewer = LeRobotDataset("me/fewer", root=tmp_path / "fewer")
    original = LeRobotDataset("me/d", root=tmp_path / "d")
    assert fewer.num_episodes == 38
    assert len(fewer) == len(original) - 2 - 6
    assert all((fewer[0][key] == original[2][key]).all() for key in ("observation.grid", "action"))
    edit(
        *here, "--operation.type=split",
        '--operation.splits={"train": 0.75, "val": 0.25}', f"--new_root={tmp_path / 'split'}",
    )  # fmt: skip
    halves = [LeRobotDataset(f"me/d_{name}", root=tmp_path / "split" / name) for name in ("train", "val")]
    assert [half.num_episodes for half in halves] == [30, 10]
    edit(
        "--new_repo_id=me/both", f"--new_root={tmp_path / 'both'}", "--operation.type=merge",
        "--operation.repo_ids=['me/d', 'me/fewer']", f"--operation.roots=['{tmp_path / 'd'}', '{tmp_path / 'fewer'}']",
    )  # fmt: skip
    both = LeRobotDataset("me/both", root=tmp_path / "both")
    assert both.num_episodes == 78
    assert both.meta.total_tasks == 30
    assert both.meta.episodes["source_index"][:40] == list(range(40))
    assert both.meta.features["action"]["names"] == original.meta.features["action"]["names"]


def test_the_next_command_can_be_typed(source, tmp_path, capsys):
    root = tmp_path / "it's my $HOME; data"
    assert main(["convert", str(source), "--root", str(root), "--repo-id", "me/d"]) == 0
    (command,) = re.findall(r"^next: (.*)$", capsys.readouterr().out, re.MULTILINE)
    assert f"--dataset.root={root}" in shlex.split(command)
