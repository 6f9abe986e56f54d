"""Words by skill: counts on hand-made episodes, and the real command on a real checkpoint."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from tiny_checkpoints import CODES, HORIZON
from torch.utils.data import default_collate

from lerobot_lisa.analysis.drawing import styled, write
from lerobot_lisa.analysis.recording.demonstrations import ask, load
from lerobot_lisa.analysis.recording.evaluation import CheckpointConfig, load_config
from lerobot_lisa.analysis.skills import words
from lerobot_lisa.analysis.skills.__main__ import main
from lerobot_lisa.analysis.skills.sheets import clouds_plot
from lerobot_lisa.analysis.skills.words import SkillWords, count_words, normalise, top_words
from lerobot_lisa.errors import UserError

LABELS = ["0", "1", "2", "3"]


def count(episodes: list[tuple[str, list[int]]]) -> SkillWords:
    """Words by skill of episodes, each an instruction and the codes of its chunks."""
    used = np.array([np.isin(range(len(LABELS)), codes) for _, codes in episodes], np.int64).reshape(-1, len(LABELS))
    return count_words([text for text, _ in episodes], used, LABELS)


def test_each_code_of_an_episode_gets_all_words() -> None:
    found = count([("Go to the ball, then go", [2, 0, 2]), ("open", [0])])
    assert found.words == ["ball", "go", "open", "the", "then", "to"]
    assert found.counts[:, 0].tolist() == [1, 2, 1, 1, 1, 1]
    assert found.counts[:, 2].tolist() == [1, 2, 0, 1, 1, 1]
    assert not found.counts[:, [1, 3]].any()


@given(st.lists(st.tuples(st.sampled_from(["go", "go to", "a b c"]), st.lists(st.integers(0, 3), min_size=1))))
def test_shares_sum_to_one_or_nothing(episodes: list[tuple[str, list[int]]]) -> None:
    counts = count(episodes).counts
    for axis in (0, 1):
        sums = normalise(counts, axis).sum(axis)
        assert np.isclose(sums, counts.sum(axis) > 0).all()


def test_top_words_set_a_skill_apart() -> None:
    found = count([("go to the red ball", [0]), ("go to the red key", [0]), ("go to the blue key", [1])] * 5)
    first, second, *unused = top_words(found, most=2)
    # "red" is a fifth of skill 0's words and two fifteenths of all.
    assert first[0] == ("red", pytest.approx(1.5))
    assert second == [("blue", pytest.approx(3.0)), ("key", pytest.approx(1.5))]
    assert unused == [[], []]


def test_codes_that_have_words_are_called_by_them(tmp_path: Path) -> None:
    found = SkillWords(["ball", "go"], np.array([[2, 0], [1, 1]]), ["0 red ball", "1 go"])
    with styled():
        plots = {plot.name: plot for plot in words.plots(found, "2 episodes")}
    table = plots["skill_words_by_skill"].table
    assert list(table["skill_code"]) == ["0 red ball", "1 go"] * 2
    ticks = plots["skill_words_by_skill"].figure.axes[0].get_xticklabels()
    assert [tick.get_text() for tick in ticks] == ["0 red ball", "1 go"]


def test_the_codes_are_those_of_a_rollout(lisa: Path, symbolic: Path) -> None:
    dataset = LeRobotDataset("local/tiny", root=symbolic)
    policy, preprocess = load(checkpoint(lisa), dataset)
    trace = ask(policy, preprocess, dataset, batch_size=4)
    chosen = [list(codes) for _, codes in trace.steps.groupby("episode")["code"]]

    lengths = list(dataset.meta.episodes["length"])
    assert [len(codes) for codes in chosen] == [-(-length // HORIZON) for length in lengths]
    assert list(trace.episodes["instruction"]) == [tasks[0] for tasks in dataset.meta.episodes["tasks"]]
    for episode in (0, 4):
        policy.reset()
        start = dataset.meta.episodes["dataset_from_index"][episode]
        seen = []
        for frame in range(start, start + lengths[episode]):
            batch = default_collate([dataset[frame]])
            observed = {key: batch[key].reshape(1, *ft.shape) for key, ft in policy.config.input_features.items()}
            policy.select_action(preprocess({**observed, "task": batch["task"]}))
            seen.append(policy.skill_codes.item())
        assert seen[::HORIZON] == chosen[episode]


def test_the_figures_are_the_same_each_time(tmp_path: Path) -> None:
    counts = np.random.default_rng(0).integers(0, 9, (18, 20))
    found = SkillWords([f"word{i}" for i in range(18)], counts, [str(code) for code in range(20)])
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        with styled():
            for plot in words.plots(found, "local/tiny: 6 episodes"):
                write(plot, tmp_path / name)
    files = [path.name for path in (tmp_path / "a").iterdir()]
    assert len(files) == 4 * 3
    assert all((tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes() for name in files)


def test_checkpoints_and_data_that_do_not_fit_are_refused(
    lisa: Path, lang_dt: Path, continuous_skills: Path, symbolic: Path, continuous: Path
) -> None:
    dataset = LeRobotDataset("local/tiny", root=symbolic)
    with pytest.raises(UserError, match="is a lang_dt policy: only lisa policies have skill codes"):
        load(checkpoint(lang_dt), dataset)
    with pytest.raises(UserError, match="has continuous skills: there are no skill codes"):
        load(checkpoint(continuous_skills), dataset)
    with pytest.raises(UserError, match=r"reads `observation\.grid` \(147,\): .* lacks it"):
        load(checkpoint(lisa), LeRobotDataset("local/tiny", root=continuous))


def test_the_papers_largest_codebook_fits_into_the_heat_maps() -> None:
    counts = np.random.default_rng(0).integers(0, 9, (5, 120))
    whole, cut = (SkillWords([*"abcde"], counts[:, :most], [str(code) for code in range(most)]) for most in (100, 120))
    with styled():
        drawn = {len(found.labels): next(words.plots(found, "1,000 episodes")) for found in (whole, cut)}
    assert drawn[100].figure.axes[0].images[0].get_array().shape == (5, 100)
    assert "Shown:" not in drawn[100].reading
    assert drawn[120].figure.axes[0].images[0].get_array().shape == (5, 100)
    assert "the 100 most frequent of 120 skills" in drawn[120].reading
    assert len(drawn[120].table) == 600


def test_every_skill_that_was_used_has_a_cloud() -> None:
    """One code in four is never used, and has none."""
    rng = np.random.default_rng(0)
    counts = rng.integers(1, 9, (6, 40)) * (np.arange(40) % 4 > 0)
    found = SkillWords(["red", "ball", "go", "to", "open", "door"], counts, [str(code) for code in range(40)])
    with styled():
        drawn = clouds_plot(found)
    titles = [axes.get_title(loc="left") for axes in drawn.figure.axes if axes.axison or axes.images]
    assert [title for title in titles if title] == [str(code) for code in range(40) if code % 4]
    assert len(drawn.table) == 240


def checkpoint(policy: Path) -> CheckpointConfig:
    return CheckpointConfig(policy=load_config(str(policy)))


def run(monkeypatch: pytest.MonkeyPatch, *options: str) -> int:
    """The command in this process."""
    monkeypatch.setattr("sys.argv", ["skills", *options])
    return main()


def test_command_line(
    lisa: Path, symbolic: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert run(monkeypatch, f"--policy.path={lisa}", f"--dataset.root={symbolic}", f"--output_dir={out}") == 0
    *_, summary, _, by_skill, _, _, clouds = capsys.readouterr().out.splitlines()
    assert Path(clouds).read_bytes().startswith(b"\x89PNG")
    assert by_skill == str(out / "skill_words_by_skill.png")
    assert Path(by_skill).read_bytes().startswith(b"\x89PNG")
    assert f"of {CODES} codes used, perplexity" in summary
    table = pd.read_csv(out / "skill_words_counts.csv")
    assert [int(label.split()[0]) for label in table["skill_code"].unique()] == list(range(CODES))
    assert "ball" in set(table["word"])


def test_what_is_wrong_is_said_in_one_line(
    lisa: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    absent, out = f"--dataset.root={tmp_path / 'absent'}", f"--output_dir={tmp_path / 'out'}"
    for options, said in (
        ([f"--policy.path={lisa}", absent, out], f"{absent}: no LeRobotDataset (meta/info.json) there"),
        ([f"--policy.path={lisa}", out], "--dataset.root is missing"),
        ([f"--policy.path={tmp_path / 'absent'}", absent, out], "no checkpoint"),
        ([absent, out], "--policy.path is missing"),
    ):
        assert run(monkeypatch, *options) == 1
        *_, last = capsys.readouterr().err.splitlines()
        assert last.startswith("error: ")
        assert said in last
    assert not (tmp_path / "out").exists()


def test_an_output_that_cannot_be_a_folder_is_said_before_the_asking(
    lisa: Path, symbolic: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (out := tmp_path / "out").write_text("precious")
    options = [f"--policy.path={lisa}", f"--dataset.root={symbolic}", f"--output_dir={out}"]
    assert run(monkeypatch, *options) == 1
    told = capsys.readouterr()
    assert told.err.splitlines()[-1] == f"error: {out}: File exists"
    assert "codes used" not in told.out
    assert out.read_text() == "precious"
