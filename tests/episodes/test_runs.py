"""What LISA calls an episode is a run of frames with one task, whatever episodes a recording has."""

from pathlib import Path

import pytest
import recordings
import torch
from hypothesis import given
from hypothesis import strategies as st
from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata

from lerobot_lisa.episodes.load import load_episodes
from lerobot_lisa.episodes.runs import task_runs
from lerobot_lisa.episodes.store import EpisodeStore


@pytest.fixture(scope="module")
def changing(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Episodes of 7, 1 and 8 frames; the task changes at step 3, and is back at step 6."""
    root = tmp_path_factory.mktemp("changing") / "data"
    tasks = ["push the cube"] * 3 + ["open the drawer"] * 3 + ["push the cube"] * 9
    return recordings.record(root, (7, 1, 8), lambda episode, step: tasks[step], cameras=())


def meta(root: Path) -> LeRobotDatasetMetadata:
    return LeRobotDatasetMetadata("local/tiny", root=root)


def test_runs_share_out_the_frames(changing: Path) -> None:
    """The same task at the end of an episode and the beginning of the next one makes no run of both."""
    runs = task_runs(meta(changing))
    assert runs.starts.tolist() == [0, 3, 6, 7, 8, 11, 14]
    assert runs.lengths.tolist() == [3, 3, 1, 1, 3, 3, 2]
    assert runs.episodes.tolist() == [0, 0, 0, 1, 2, 2, 2]


def test_a_frame_brings_its_run(changing: Path) -> None:
    store = load_episodes(meta(changing), ["observation.state", "action"])
    frames = torch.tensor([4, 15, 4, 7])
    columns, packing = store.gather(store.holding(frames))
    assert packing.lengths.tolist() == [3, 2, 3, 1]
    steps = [[0, 3], [0, 4], [0, 5], [2, 6], [2, 7], [0, 3], [0, 4], [0, 5], [1, 0]]
    assert columns["observation.state"].tolist() == steps


def test_one_task_for_each_episode_makes_runs_of_episodes(symbolic: Path) -> None:
    runs = task_runs(meta(symbolic))
    assert runs.episodes.tolist() == list(range(6))
    assert runs.starts.tolist() == list(meta(symbolic).episodes["dataset_from_index"])


@given(st.lists(st.integers(1, 5), min_size=1, max_size=8))
def test_every_frame_is_held_by_the_run_it_lies_in(lengths: list[int]) -> None:
    starts = [sum(lengths[:i]) for i in range(len(lengths))]
    store = EpisodeStore({"x": torch.arange(sum(lengths))}, starts, lengths)
    expected = [run for run, length in enumerate(lengths) for _ in range(length)]
    assert store.holding(torch.arange(sum(lengths))).tolist() == expected
