"""The bulk writer makes the files that LeRobot's own writer makes, whatever the episodes are."""

import hashlib
import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import torch
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from lerobot.datasets.aggregate import aggregate_datasets
from lerobot.datasets.compute_stats import compute_episode_stats
from lerobot.datasets.lerobot_dataset import LeRobotDataset

from dataset_converters.stats import numeric_stats
from dataset_converters.subtasks import Subtask
from dataset_converters.writer import DatasetLayout, Episode, write_dataset
from lerobot_lisa.errors import UserError

FEATURES = {
    "observation.grid": {"dtype": "uint8", "shape": (5,), "names": [f"cell_{i}" for i in range(5)]},
    "observation.state": {"dtype": "float32", "shape": (3,), "names": ["x", "y", "z"]},
    "action": {"dtype": "int64", "shape": (1,), "names": {"classes": ["left", "right", "forward"]}},
}
LAYOUT = DatasetLayout("me/random", 10, FEATURES, {"seed": pa.int64(), "level": pa.string()})


def random_episodes(lengths: list[int], seed: int = 0) -> list[Episode]:
    rng = np.random.default_rng(seed)
    return [
        Episode(
            f"task {rng.integers(3)}",
            {
                "observation.grid": rng.integers(0, 256, (length, 5), dtype=np.uint8),
                "observation.state": rng.normal(size=(length, 3)).astype(np.float32),
                "action": rng.integers(0, 3, length),
            },
            {"seed": 1_000_000 + i, "level": "GoToSeq"},
        )
        for i, length in enumerate(lengths)
    ]


def written_by_lerobot(root: Path, episodes: list[Episode], features: dict = FEATURES) -> LeRobotDataset:
    dataset = LeRobotDataset.create("me/random", fps=10, features=features, root=root, use_videos=False)
    for episode in episodes:
        for t in range(len(next(iter(episode.frames.values())))):
            frame = {key: values[t].reshape(features[key]["shape"]) for key, values in episode.frames.items()}
            dataset.add_frame({**frame, "task": episode.task})
        dataset.save_episode()
    dataset.finalize()
    return LeRobotDataset("me/random", root=root)


def assert_same_items(ours: LeRobotDataset, theirs: LeRobotDataset) -> None:
    assert len(ours) == len(theirs)
    for mine, yours in zip(ours, theirs, strict=True):
        assert mine.keys() == yours.keys()
        for key, value in mine.items():
            if key == "task_index":  # numbered in order of appearance by both, but compared through the string below
                continue
            if isinstance(value, torch.Tensor):
                assert value.dtype == yours[key].dtype
                assert torch.equal(value, yours[key]), key
            else:
                assert value == yours[key]


@pytest.fixture(scope="module")
def both(tmp_path_factory):
    root = tmp_path_factory.mktemp("both")
    episodes = random_episodes([1, 2, 30, 7])
    write_dataset(root / "ours", LAYOUT, episodes)
    return LeRobotDataset("me/random", root=root / "ours"), written_by_lerobot(root / "theirs", episodes)


def test_items_equal_those_of_lerobots_own_writer(both):
    assert_same_items(*both)


def test_files_have_lerobots_schema_and_layout(both):
    ours, theirs = both
    assert sorted(p.relative_to(ours.root) for p in ours.root.rglob("*.*")) == sorted(
        p.relative_to(theirs.root) for p in theirs.root.rglob("*.*")
    )
    for kind in ("data", "meta/episodes"):
        file = f"{kind}/chunk-000/file-000.parquet"
        mine, yours = pq.read_schema(ours.root / file), pq.read_schema(theirs.root / file)
        for field in yours:
            assert mine.field(field.name).type == field.type, field.name
        assert set(mine.names) - set(yours.names) <= {"seed", "level"}
        if kind == "data":  # theirs also has a random fingerprint
            described = [json.loads(schema.metadata[b"huggingface"])["info"] for schema in (mine, yours)]
            assert described[0] == described[1]
    assert json.loads((ours.root / "meta/info.json").read_text()) == json.loads(
        (theirs.root / "meta/info.json").read_text()
    )


def test_dataset_statistics_agree_with_lerobots(both):
    ours, theirs = both
    assert ours.meta.stats.keys() == theirs.meta.stats.keys()
    for key, stats in theirs.meta.stats.items():
        span = stats["max"] - stats["min"]
        for name, value in stats.items():
            assert ours.meta.stats[key][name].shape == value.shape
            bin_width = span / 5000 if name.startswith("q") else 0
            assert np.all(np.abs(ours.meta.stats[key][name] - value) <= bin_width + 1e-3 * (1 + np.abs(value))), name


@given(
    values=st.integers(1, 60).flatmap(lambda n: st.lists(st.tuples(*[st.integers(0, 10)] * 2), min_size=n, max_size=n)),
    dtype=st.sampled_from(["uint8", "int64", "float32"]),
)
@settings(max_examples=60, deadline=None)
def test_episode_statistics_are_within_one_histogram_bin_of_lerobots(values, dtype):
    table = np.array(values, dtype=dtype)
    theirs = compute_episode_stats({"x": table}, {"x": {"dtype": dtype, "shape": (2,)}})["x"]
    ours = numeric_stats(table)
    bin_width = (theirs["max"] - theirs["min"]) / 5000
    for name, value in theirs.items():
        assert ours[name].shape == value.shape
        # LeRobot's float32 mean of squares loses up to ~1e-3 of the standard deviation
        assert np.all(np.abs(ours[name] - value) <= 1.001 * bin_width + 2e-3), name


@given(lengths=st.lists(st.integers(1, 25), min_size=1, max_size=6), seed=st.integers(0, 99))
@settings(max_examples=8, deadline=None, phases=[Phase.explicit, Phase.generate])  # each example writes a dataset
def test_every_value_comes_back(tmp_path_factory, lengths, seed):
    root = tmp_path_factory.mktemp("round") / "trip"
    episodes = random_episodes(lengths, seed)
    totals = write_dataset(root, LAYOUT, episodes)
    dataset = LeRobotDataset("me/random", root=root)
    assert (totals.episodes, totals.frames) == (len(lengths), sum(lengths)) == (dataset.num_episodes, len(dataset))
    assert totals.tasks == dataset.meta.total_tasks == len({episode.task for episode in episodes})
    table = dataset.hf_dataset.with_format("numpy")[:]
    stored = dataset.hf_dataset.data.schema
    for key in FEATURES:
        expected = np.concatenate([episode.frames[key] for episode in episodes])
        kind = pa.from_numpy_dtype(expected.dtype)
        assert stored.field(key).type == (kind if expected.ndim == 1 else pa.list_(kind, expected.shape[1]))
        assert np.array_equal(table[key], expected)
    assert np.array_equal(table["index"], np.arange(sum(lengths)))
    assert [dataset.meta.tasks.index[i] for i in table["task_index"]] == [
        episode.task for episode in episodes for _ in range(len(episode.frames["action"]))
    ]
    for row, episode in zip(dataset.meta.episodes, episodes, strict=True):
        assert {key: row[key] for key in episode.metadata} == dict(episode.metadata)
        assert row["tasks"] == [episode.task]


def test_images_are_stored_as_lerobot_stores_them(tmp_path):
    features = {
        "observation.images.top": {"dtype": "image", "shape": (8, 6, 3), "names": ["height", "width", "channels"]},
        "action": {"dtype": "float32", "shape": (2,), "names": ["x", "y"]},
    }
    rng = np.random.default_rng(0)
    episodes = [
        Episode(
            "look",
            {
                "observation.images.top": rng.integers(0, 256, (length, 8, 6, 3), dtype=np.uint8),
                "action": rng.normal(size=(length, 2)).astype(np.float32),
            },
        )
        for length in (3, 2)
    ]
    write_dataset(tmp_path / "ours", DatasetLayout("me/random", 10, features), episodes)
    ours = LeRobotDataset("me/random", root=tmp_path / "ours")
    theirs = written_by_lerobot(tmp_path / "theirs", episodes, features)
    assert_same_items(ours, theirs)
    for name, value in theirs.meta.stats["observation.images.top"].items():
        assert np.allclose(ours.meta.stats["observation.images.top"][name], value, rtol=1e-6), name
    kinds = [pq.read_schema(d.root / "meta/episodes/chunk-000/file-000.parquet") for d in (ours, theirs)]
    assert kinds[0].field("stats/observation.images.top/mean").type == (
        kinds[1].field("stats/observation.images.top/mean").type
    )


def tree_hash(root: Path) -> dict[str, str]:
    return {
        str(p.relative_to(root)): hashlib.sha256(p.read_bytes()).hexdigest()
        for p in sorted(root.rglob("*"))
        if p.is_file()
    }


def test_same_episodes_same_bytes(tmp_path):
    for name in ("a", "b"):
        write_dataset(tmp_path / name, LAYOUT, random_episodes([4, 9]))
    assert tree_hash(tmp_path / "a") == tree_hash(tmp_path / "b")


def test_files_roll_over_by_size_and_stay_one_dataset(tmp_path):
    layout = DatasetLayout("me/random", 10, FEATURES, LAYOUT.episode_columns, data_files_size_in_mb=1)
    episodes = random_episodes([8000] * 9)
    write_dataset(tmp_path / "d", layout, episodes)
    files = sorted((tmp_path / "d/data").rglob("*.parquet"))
    assert len(files) > 1
    assert all(file.stat().st_size < 1.1 * 1024**2 for file in files)
    dataset = LeRobotDataset("me/random", root=tmp_path / "d")
    assert np.array_equal(
        dataset.hf_dataset.with_format("numpy")["action"][:], np.concatenate([e.frames["action"] for e in episodes])
    )
    for i, row in enumerate(dataset.meta.episodes):
        stored = pq.read_table(tmp_path / "d" / dataset.meta.get_data_file_path(i), columns=["episode_index"])
        assert row["episode_index"] in stored["episode_index"].to_pylist()


def test_aggregation_keeps_the_episode_columns(tmp_path):
    for name, seed in (("a", 0), ("b", 1)):
        write_dataset(tmp_path / name, LAYOUT, random_episodes([3, 4], seed))
    aggregate_datasets(
        ["me/random"] * 2, "me/both", roots=[tmp_path / "a", tmp_path / "b"], aggr_root=tmp_path / "both"
    )
    merged = LeRobotDataset("me/both", root=tmp_path / "both")
    assert merged.num_episodes == 4
    assert merged.meta.episodes["seed"] == [1_000_000, 1_000_001] * 2
    assert merged.meta.features["action"]["names"] == FEATURES["action"]["names"]


def test_many_distinct_tasks_cost_no_more_than_one_task(tmp_path):
    """LeRobot rewrites every task at each new one; here tasks are a dictionary that is written once."""

    def episodes(distinct: int):
        frames = random_episodes([2])[0].frames
        return (Episode(f"task {i % distinct}", frames, {"seed": i, "level": "x"}) for i in range(3000))

    writes = []
    tasks_file = "tasks.parquet"
    for distinct in (1, 3000):
        root = tmp_path / str(distinct)

        def watched(stream, root=root):
            for episode in stream:
                writes.append((root / "meta" / tasks_file).exists())
                yield episode

        assert write_dataset(root, LAYOUT, watched(episodes(distinct))).tasks == distinct
    assert not any(writes)
    assert len(pq.read_table(tmp_path / "3000/meta" / tasks_file)) == 3000


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"action": np.zeros(4, np.int64)}, "action is int64"),
        ({"action": np.zeros(3, np.int32)}, "action is int32"),
        ({"observation.state": np.zeros((3, 4), np.float32)}, "observation.state is float32"),
        ({"extra": np.zeros(3)}, "has features"),
        ({key: values[:0] for key, values in random_episodes([1])[0].frames.items()}, "no frames"),
    ],
)
def test_an_episode_that_does_not_fit_is_refused_by_number(tmp_path, change, message):
    good, bad = random_episodes([3, 3])
    with pytest.raises(UserError, match=f"episode 1: .*{message}"):
        write_dataset(tmp_path / "d", LAYOUT, [good, Episode(bad.task, {**bad.frames, **change})])


def test_no_episode_and_unsupported_features_are_refused(tmp_path):
    with pytest.raises(UserError, match="no episode"):
        write_dataset(tmp_path / "a", LAYOUT, [])
    video = {"observation.images.top": {"dtype": "video", "shape": (8, 8, 3), "names": None}}
    with pytest.raises(UserError, match="dtype video"):
        write_dataset(tmp_path / "b", DatasetLayout("me/x", 10, video), [])
    with pytest.raises(UserError, match="fps is 0"):
        write_dataset(tmp_path / "c", DatasetLayout("me/x", 0, FEATURES), [])


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("key", ["observation.state", "action"])
def test_values_that_are_not_finite_are_refused_by_episode_and_feature(tmp_path, key, value):
    features = {name: {"dtype": "float32", "shape": (2,), "names": None} for name in ("observation.state", "action")}
    good, bad = ({name: np.zeros((5, 2), np.float32) for name in features} for _ in range(2))
    bad[key][3, 1] = value
    with pytest.raises(UserError, match=f"^episode 1: {key} is NaN or infinite at frame 3;"):
        write_dataset(tmp_path / "d", DatasetLayout("me/x", 10, features), [Episode("a", good), Episode("b", bad)])


@pytest.mark.parametrize(
    ("task", "message"),
    [
        ("", "non-empty instruction"),
        (" \u200b ", "non-empty instruction"),
        (None, "non-empty instruction"),
        ("a\nb\n# heading\n---\nlicense: evil", "control characters"),
        ("tab\there", "control characters"),
        ("\x1b[31mred", "control characters"),
        ("go\x00", "control characters"),
        ("line\u2028separator", "control characters"),
        ("\u202etxt.exe", "control characters"),
        ("half \ud800", "control characters"),
        ("x" * 100_000, "100,000 characters"),
    ],
)
def test_instructions_that_are_no_line_of_text_are_refused(tmp_path, task, message):
    with pytest.raises(UserError, match=message) as caught:
        write_dataset(tmp_path / "d", LAYOUT, [Episode(task, random_episodes([1])[0].frames)])
    assert str(caught.value).startswith("episode 0: the task ")
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 200


@pytest.mark.parametrize("task", ["שלום עולם", "赤い\u3000ボール", "a\u200cb", "👩\u200d🚀 go", "Go to the red ball "])
def test_instructions_in_any_script_are_kept(tmp_path, task):
    write_dataset(tmp_path / "d", LAYOUT, [Episode(task, random_episodes([1])[0].frames)])
    assert list(LeRobotDataset("me/random", root=tmp_path / "d").meta.tasks.index) == [task]


def test_subtasks_of_an_episode_are_refused_where_they_do_not_fit(tmp_path: Path) -> None:
    layout = replace(LAYOUT, subtasks=True)
    for subtasks, said in (
        ([Subtask(1, "open"), Subtask(0, "go")], "episode 0: the subtasks begin at frames [1, 0] of 5"),
        ([Subtask(5, "open")], "begin at frames [5] of 5: let them begin one after another"),
        ([Subtask(0, "")], "episode 0: the subtasks: the one of frame 0 is ''"),
    ):
        episodes = [replace(random_episodes([5])[0], subtasks=subtasks)]
        with pytest.raises(UserError, match=re.escape(said)):
            write_dataset(tmp_path / "data", layout, episodes)
        shutil.rmtree(tmp_path / "data")


def test_shards_with_subtasks_merge(tmp_path: Path) -> None:
    """LeRobot's own merging keeps them; an episode may have none."""
    layout = replace(LAYOUT, subtasks=True)
    told = [replace(episode, subtasks=[Subtask(0, "go"), Subtask(2, "open")]) for episode in random_episodes([5, 3])]
    silent = random_episodes([4], seed=1)
    for name, episodes in (("a", told), ("b", silent)):
        write_dataset(tmp_path / name, layout, episodes)
    roots = [tmp_path / "a", tmp_path / "b"]
    aggregate_datasets(["me/random"] * 2, "me/random", roots=roots, aggr_root=tmp_path / "both")
    merged = LeRobotDataset("me/random", root=tmp_path / "both")
    counts = [len(merged[frame]["language_persistent"]) for frame in range(len(merged))]
    assert counts == [2] * 8 + [0] * 4
