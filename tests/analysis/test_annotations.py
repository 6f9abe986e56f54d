"""Skills beside annotated subtasks: numbers of codes that match and that do not, and the real commands."""

import json
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
import tiny_annotations
import tiny_checkpoints
import tiny_datasets
from hypothesis import given
from hypothesis import strategies as st
from lerobot.datasets.language_render import active_at
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import maximum_bipartite_matching
from tiny_checkpoints import HORIZON

from dataset_converters.subtasks import Subtask
from dataset_converters.writer import DatasetLayout, Episode, write_dataset
from lerobot_lisa.analysis.annotations.__main__ import main
from lerobot_lisa.analysis.annotations.match import F1, V_MEASURE, Alignment, Score, align, count_pairs, score
from lerobot_lisa.analysis.annotations.subtasks import read_subtasks
from lerobot_lisa.analysis.recording.demonstrations import ask, load
from lerobot_lisa.analysis.recording.evaluation import CheckpointConfig, load_config
from lerobot_lisa.errors import UserError

LENGTHS = [7, 12, 9, 20]
SUBTASKS = [
    [Subtask(0, "go"), Subtask(3, "open")],
    [Subtask(0, "open"), Subtask(5, "go"), Subtask(11, "open")],
    [Subtask(2, "pick up the key")],
    [],
]


@pytest.fixture(scope="module")
def annotated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Root of a dataset with BabyAI's features whose episodes have `SUBTASKS`: some late, and one none."""
    root, rng = tmp_path_factory.mktemp("annotated") / "data", np.random.default_rng(0)
    features = {
        "observation.grid": tiny_datasets.GRID,
        "observation.direction": tiny_datasets.DIRECTION,
        "action": tiny_datasets.CLASSES,
    }
    episodes = [
        Episode(
            "go and open",
            {key: tiny_datasets._random(rng, key, length, feature) for key, feature in features.items()},
            subtasks=subtasks,
        )
        for length, subtasks in zip(LENGTHS, SUBTASKS, strict=True)
    ]
    write_dataset(root, DatasetLayout("local/annotated", 10, features, subtasks=True), episodes)
    return root


@pytest.fixture(scope="module")
def policy(annotated: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a LISA checkpoint that was trained on it."""
    return tiny_checkpoints.lisa(annotated, tmp_path_factory.mktemp("policy"))


def episodes_of(lengths: list[list[int]], horizon: int, seed: int, kinds: int = 4) -> tuple[Alignment, np.ndarray]:
    """Episodes whose subtasks last so many steps each, and the subtask at the beginning of each chunk."""
    rng = np.random.default_rng(seed)
    episode, length, subtask = [], [], []
    for number, parts in enumerate(lengths):
        order = rng.permutation(kinds)
        subtask += [order[part % kinds] for part, steps in enumerate(parts) for _ in range(steps)]
        chunks = -(-sum(parts) // horizon)
        episode += [number] * chunks
        length += [horizon] * (chunks - 1) + [sum(parts) - horizon * (chunks - 1)]
    starts = np.cumsum(length) - length
    told = np.array(subtask)
    return Alignment(np.array(episode), np.array(length), told[starts], told), told[starts]


def by_name(scores: list[Score]) -> dict[str, Score]:
    return {score.name: score for score in scores}


def test_codes_that_are_the_subtasks_under_other_names_reach_everything() -> None:
    found, subtask = episodes_of([[6, 9, 3], [3, 12], [9, 3, 6, 6]] * 20, horizon=3, seed=0)
    renamed = np.array([7, 2, 9, 4])[subtask]
    for each in score(Alignment(found.episode, found.length, renamed, found.subtask), 50):
        assert each.value == pytest.approx(1)
        assert each.ideal == pytest.approx(1)
        assert each.p_value == pytest.approx(1 / 51)
        assert each.interval[1] < 0.95


def test_codes_that_know_nothing_of_subtasks_are_within_chance() -> None:
    found, _ = episodes_of([[6, 9, 3], [3, 12], [9, 3, 6, 6]] * 40, horizon=3, seed=0)
    outside = 0
    for seed in range(10):
        codes = np.random.default_rng(seed).integers(0, 5, len(found.code))
        scores = score(Alignment(found.episode, found.length, codes, found.subtask), 100, seed=seed)
        outside += sum(each.p_value < 0.05 for each in scores)
        assert abs(by_name(scores)["adjusted Rand index"].value) < 0.02
        assert by_name(scores)[V_MEASURE].value > 0  # which is why chance is told
    assert outside <= 10  # of 70


def test_chance_only_knows_another_order_within_an_episode() -> None:
    """A code for each episode tells which episode it is, and nothing about when: every other order is the same."""
    found, _ = episodes_of([[6, 9, 3], [3, 12], [9, 3, 6, 6]], horizon=3, seed=0)
    codes = Alignment(found.episode, found.length, found.episode, found.subtask)
    scores = by_name(score(codes, 20))
    assert scores[V_MEASURE].value > 0
    for name in ("homogeneity", "completeness", V_MEASURE, "adjusted Rand index"):
        assert np.allclose(scores[name].chance, scores[name].value)
        assert scores[name].p_value == 1
    assert np.isnan(scores["boundary precision"].value)  # the code never changes
    assert scores["boundary recall"].value == scores[F1].value == 0


def test_one_code_for_all_is_complete_and_says_nothing() -> None:
    found, _ = episodes_of([[6, 9, 3], [3, 12]], horizon=3, seed=0)
    scores = by_name(score(Alignment(found.episode, found.length, np.zeros_like(found.code), found.subtask), 20))
    assert (scores["homogeneity"].value, scores["completeness"].value, scores[V_MEASURE].value) == (0, 1, 0)


def test_the_horizon_limits_what_codes_can_reach() -> None:
    """Subtasks that change in the middle of chunks of 10 steps: no code can follow them."""
    found, _ = episodes_of([[14, 10, 10, 6]] * 10, horizon=10, seed=0)
    scores = by_name(score(found, 20))
    assert scores[V_MEASURE].ideal < 0.9
    assert scores["boundary recall"].ideal == 0
    assert by_name(score(found, 20, tolerance=4))["boundary recall"].ideal == 1


def test_steps_without_annotation_do_not_count() -> None:
    found, subtask = episodes_of([[6, 9, 3], [3, 12]] * 10, horizon=3, seed=0)
    silent = np.concatenate([np.repeat(subtask, found.length)[:0], found.subtask, np.full(9, -1)])
    longer = Alignment(
        np.append(found.episode, [20] * 3), np.append(found.length, [3] * 3), np.append(subtask, [0, 1, 2]), silent
    )
    assert [each.value for each in score(longer, 20)] == [each.value for each in score(found, 20)]


@given(
    ours=st.sets(st.integers(0, 30), max_size=8).map(sorted),
    theirs=st.sets(st.integers(0, 30), max_size=8).map(sorted),
    tolerance=st.integers(0, 4),
)
def test_as_many_changes_are_paired_as_can_be(ours: list[int], theirs: list[int], tolerance: int) -> None:
    near = np.array([[abs(a - b) <= tolerance for b in theirs] for a in ours], bool).reshape(len(ours), len(theirs))
    most = (maximum_bipartite_matching(csr_matrix(near), perm_type="column") >= 0).sum() if near.size else 0
    assert count_pairs(ours, theirs, tolerance) == most


def test_changes_are_not_paired_across_episodes() -> None:
    """The code changes at the last step of one episode, the subtask at the second of the next."""
    found = Alignment(
        np.array([0, 0, 1, 1]), np.array([3, 1, 1, 3]), np.array([0, 1, 1, 1]), np.array([0] * 5 + [1] * 3)
    )
    scores = by_name(score(found, 20))
    assert scores["boundary precision"].value == scores["boundary recall"].value == 0


def test_each_frame_has_the_subtask_that_lerobot_says_is_active(annotated: Path) -> None:
    dataset = LeRobotDataset("local/annotated", root=annotated)
    found = read_subtasks(dataset.meta)
    assert set(found.labels) == {"go", "open", "pick up the key"}
    for frame, place in enumerate(found.frames):
        row = dataset[frame]
        active = active_at(row["timestamp"].item(), persistent=row["language_persistent"], style="subtask")
        assert (active["content"] if active else None) == (found.labels[place] if place >= 0 else None)


def test_what_lerobot_annotates_is_read_alike(annotated: Path, tmp_path: Path) -> None:
    """Its own writer leaves other types in the files than LeRobot's recorder does."""
    root = tiny_datasets.symbolic(tmp_path / "data", LENGTHS)
    tiny_annotations.annotate(root, tmp_path / "staging", {n: rows for n, rows in enumerate(SUBTASKS) if rows})
    theirs = read_subtasks(LeRobotDataset("local/tiny", root=root).meta)
    ours = read_subtasks(LeRobotDataset("local/annotated", root=annotated).meta)
    assert theirs.labels == ours.labels
    assert theirs.frames.tolist() == ours.frames.tolist()


def test_codes_lie_beside_the_subtasks_of_their_own_steps(annotated: Path, policy: Path) -> None:
    dataset = LeRobotDataset("local/annotated", root=annotated)
    subtasks = read_subtasks(dataset.meta)
    trace = ask(*load(CheckpointConfig(policy=load_config(str(policy))), dataset), dataset)
    found = align(trace, subtasks)
    assert found.length.tolist() == [
        min(HORIZON, length - step) for length in LENGTHS for step in range(0, length, HORIZON)
    ]
    assert found.subtask.tolist() == subtasks.frames.tolist()
    assert found.code.tolist() == trace.steps["code"].tolist()
    fewer = align(ask(*load(CheckpointConfig(policy=load_config(str(policy))), dataset), dataset, most=2), subtasks)
    assert fewer.subtask.tolist() == subtasks.frames[: sum(LENGTHS[:2])].tolist()
    assert fewer.code.tolist() == found.code[: len(fewer.code)].tolist()


def run(monkeypatch: pytest.MonkeyPatch, *options: str) -> int:
    """The command in this process."""
    monkeypatch.setattr("sys.argv", ["annotations", *options])
    return main()


def test_the_command(
    annotated: Path, policy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    options = [f"--policy.path={policy}", f"--dataset.root={annotated}", "--permutations=20"]
    for out in ("a", "b"):
        assert run(monkeypatch, *options, f"--output_dir={tmp_path / out}") == 0
    names = {path.name for path in (tmp_path / "a").iterdir()}
    figures = {
        f"annotation_{name}.{end}" for name, end in product(("scores", "codes", "episodes"), ("png", "pdf", "csv"))
    }
    assert names == {"annotations.json", *figures}
    assert all((tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes() for name in names)
    said = json.loads((tmp_path / "a/annotations.json").read_text())
    assert (said["episodes"], said["steps"], said["steps_annotated"], said["subtasks"]) == (4, 48, 26, 3)
    assert said["changes_of_subtask"] == 3
    assert set(said["scores"]["V-measure"]) == {
        "value", "chance_mean", "chance_low", "chance_high", "p_value", "ideal"
    }  # fmt: skip
    table = pd.read_csv(tmp_path / "a/annotation_codes.csv")
    assert table["steps"].sum() == 26
    assert "4 episodes of data, 26 of 48 steps annotated, 3 subtasks" in capsys.readouterr().out


def test_a_report_says_it_of_annotated_training_data(
    policy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from lerobot_lisa.analysis.report.command import main as report

    world = ["--env.type=babyai", "--env.task=GoToLocal", "--env.max_episode_steps=4", "--listening=false"]
    numbers = ["--n_episodes=2", "--batch_size=2", "--permutations=20", "--examples=0"]
    for name, more in (("with", []), ("without", ["--annotated_episodes=0"])):
        output = f"--output_dir={tmp_path / name}"
        monkeypatch.setattr("sys.argv", ["lisa-report", f"--policy.path={policy}", *world, *numbers, output, *more])
        assert report() == 0
    page = (tmp_path / "with/report.html").read_text(encoding="utf-8")
    assert "<h2>Skills and annotations</h2>" in page
    assert "<dt>Codes match subtasks</dt>" in page
    assert (tmp_path / "with/figures/annotation_scores.csv").is_file()
    assert "Skills and annotations" not in (tmp_path / "without/report.html").read_text(encoding="utf-8")


def test_a_report_goes_without_annotations_that_say_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Annotated, but with plans only."""
    from lerobot_lisa.analysis.report.command import main as report

    root = tiny_datasets.symbolic(tmp_path / "data", LENGTHS)
    tiny_annotations.annotate(root, tmp_path / "staging", {0: [(0, "1. go 2. open")]}, style="plan")
    policy = tiny_checkpoints.lisa(root, tmp_path / "policy")
    world = ["--env.type=babyai", "--env.task=GoToLocal", "--env.max_episode_steps=4", "--listening=false"]
    numbers = ["--n_episodes=1", "--permutations=20", "--examples=0", f"--output_dir={tmp_path / 'out'}"]
    monkeypatch.setattr("sys.argv", ["lisa-report", f"--policy.path={policy}", *world, *numbers])
    assert report() == 0
    page = (tmp_path / "out/report.html").read_text(encoding="utf-8")
    assert "Skills were not compared with annotations." in page
    assert "holds no subtask, only plan" in page


def test_what_cannot_be_compared_is_said_in_one_line(
    annotated: Path, policy: Path, lang_dt: Path, symbolic: Path, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    own, data = f"--policy.path={policy}", f"--dataset.root={annotated}"
    for options, said in (
        ([own, f"--dataset.root={symbolic}"], "has no annotated subtasks (`language_persistent`): annotate it with"),
        ([own, data, "--style=plan"], "holds no plan, only subtask: annotate it with lerobot-annotate"),
        ([own, data, "--n_episodes=0"], "--n_episodes=0: give a number from 1"),
        ([own, data, "--permutations=1"], "--permutations=1: give a number from 20"),
        ([f"--policy.path={lang_dt}", data], "is a lang_dt policy: only lisa policies have skill codes"),
        ([own], "--dataset.root is missing"),
    ):
        assert run(monkeypatch, *options, f"--output_dir={tmp_path / 'out'}") == 1
        *_, last = capsys.readouterr().err.splitlines()
        assert last.startswith("error: ")
        assert said in last
    assert not (tmp_path / "out").exists()


def test_annotations_that_never_differ_cannot_be_compared(
    policy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    root = tiny_datasets.symbolic(tmp_path / "data", LENGTHS)
    tiny_annotations.annotate(root, tmp_path / "staging", {0: [(0, "go")], 1: [(0, "go"), (4, "go")]})
    assert run(monkeypatch, f"--policy.path={policy}", f"--dataset.root={root}", f"--output_dir={tmp_path / 'o'}") == 1
    said = "its first 4 episodes hold fewer than two different annotations of style subtask"
    assert said in capsys.readouterr().err.splitlines()[-1]


@pytest.mark.parametrize("broken", ["column", "time"])
def test_files_that_lerobot_did_not_annotate_are_named(broken: str, tmp_path: Path) -> None:
    root = tiny_datasets.symbolic(tmp_path / "data", LENGTHS)
    tiny_annotations.annotate(root, tmp_path / "staging", {0: [(0, "go")], 1: [(0, "open")]})
    (path,) = (root / "data").rglob("*.parquet")
    table = pq.read_table(path).to_pandas()
    if broken == "column":
        table["language_persistent"] = "go"
    else:
        table["language_persistent"] = [[{"content": "go", "style": "subtask", "timestamp": np.inf}]] * len(table)
    meta = LeRobotDataset("local/tiny", root=root).meta
    table.to_parquet(path)
    said = {"column": "which lerobot-annotate does not write", "time": "'go' begins at inf, which is no time"}
    with pytest.raises(UserError, match=said[broken]) as refused:
        read_subtasks(meta)
    assert str(path) in str(refused.value)
