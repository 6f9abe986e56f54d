"""`lisa-report` itself on tiny checkpoints: what it writes, what it does again, what it refuses."""

import re
import shutil
import sys
from pathlib import Path

import pandas as pd
import pytest
import tiny_checkpoints

from lerobot_lisa.analysis import training_data
from lerobot_lisa.analysis.recording import frames
from lerobot_lisa.analysis.recording.traces import EPISODES_FILE, STEPS_FILE
from lerobot_lisa.analysis.report.command import main
from lerobot_lisa.analysis.skills.sheets import check_font
from lerobot_lisa.errors import UserError


def run(monkeypatch: pytest.MonkeyPatch, policy: Path, output: Path, *more: str) -> int:
    """The command, in this process."""
    options = [f"--policy.path={policy}", "--env.type=babyai", "--env.task=GoToLocal", "--env.max_episode_steps=8"]
    numbers = ["--n_episodes=3", "--batch_size=2", "--permutations=20", f"--output_dir={output}"]
    monkeypatch.setattr(sys, "argv", ["lisa-report", *options, *numbers, *more])
    return main()


@pytest.fixture(scope="module")
def made(lisa: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a report."""
    output = tmp_path_factory.mktemp("report") / "out"
    with pytest.MonkeyPatch.context() as patch:
        assert run(patch, lisa, output) == 0
    return output


def test_a_report_is_a_page_figures_and_a_trace(made: Path) -> None:
    assert {path.name for path in made.iterdir()} == {"report.html", "figures", "trace", "listening"}
    assert {STEPS_FILE, EPISODES_FILE, "frames.parquet"} <= {path.name for path in (made / "trace").iterdir()}
    page = (made / "report.html").read_text(encoding="utf-8")
    assert "<h1>LISA on BabyAI GoToLocal</h1>" in page
    assert "3 episodes with seeds 1000 to 1002" in page
    assert "5 different instructions." in page  # of the training data
    assert (made / "figures" / "success_seen_and_unseen_instructions.csv").is_file()


def test_the_numbers_are_those_of_the_trace(made: Path) -> None:
    steps = pd.read_parquet(made / "trace" / STEPS_FILE)
    chosen = steps[steps["step"] % tiny_checkpoints.HORIZON == 0]["code"].value_counts()
    usage = pd.read_csv(made / "figures" / "code_usage.csv").set_index("skill_code")["choices"]
    assert {int(label.split()[0]): times for label, times in usage[usage > 0].items()} == chosen.to_dict()
    episodes = pd.read_parquet(made / "trace" / EPISODES_FILE)
    overall = pd.read_csv(made / "figures" / "success_overall.csv").iloc[0]
    assert (overall["successes"], overall["episodes"]) == (episodes["success"].sum(), 3)


def test_success_stands_beside_how_much_of_it_is_listening(made: Path) -> None:
    numbers = pd.read_csv(made / "figures" / "heard.csv").set_index("number")
    overall = pd.read_csv(made / "figures" / "success_overall.csv").iloc[0]
    assert numbers.loc["success", "value"] == pytest.approx(overall["percent"], rel=1e-4)
    assert {"heard", "SPL", "success within 1 x", "heard within 4 x"} <= set(numbers.index)
    page = (made / "report.html").read_text(encoding="utf-8")
    assert "<dt>Heard</dt>" in page
    assert "<dt>SPL</dt>" in page


def test_listening_need_not_be_asked(lisa: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert run(monkeypatch, lisa, tmp_path / "out", "--listening=false") == 0
    assert not (tmp_path / "out" / "listening").exists()
    assert "<dt>Heard</dt>" not in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")


def test_frames_show_chunks_that_followed_the_code(made: Path) -> None:
    steps = pd.read_parquet(made / "trace" / STEPS_FILE).set_index(["episode", "step"])
    examples = frames.read(made / "trace")
    assert {example.code for example in examples} == set(steps["code"])
    for example in examples:
        assert steps.loc[(example.episode, example.step), "code"] == example.code
        assert steps.loc[(example.episode, example.step), "instruction"] == example.instruction
        length = min(tiny_checkpoints.HORIZON, (steps.loc[example.episode].index >= example.step).sum())
        assert len(example.frames) == length + 1
        assert len({picture.shape for picture in example.pictures()}) == 1


def test_it_says_where_skills_look(made: Path) -> None:
    page = (made / "report.html").read_text(encoding="utf-8")
    assert "<h2>Where skills look</h2>" in page
    assert "<dt>Looks</dt>" in page
    assert "It pays " in page or "It looks at nothing" in page
    used = set(pd.read_parquet(made / "trace" / STEPS_FILE)["code"])
    places = pd.read_csv(made / "figures" / "looks_grid.csv")
    named = pd.read_csv(made / "figures" / "looks_by_name.csv")
    assert len(places) == 49 * len(used)
    assert {int(label.split()[0]) for label in named["skill_code"]} == used
    by_skill = named.groupby("skill_code")
    assert by_skill["attention"].sum().tolist() == pytest.approx(by_skill["attention_paid"].first().tolist(), abs=1e-4)


@pytest.fixture(scope="module")
def two_parts(symbolic: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a LISA checkpoint with codes of two parts, 40 of each."""
    settings = {"n_code_parts": 2, "codebook_size": 40}
    return tiny_checkpoints.lisa(symbolic, tmp_path_factory.mktemp("two_parts"), **settings)


def test_of_many_codes_those_that_were_used_are_told(
    two_parts: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(monkeypatch, two_parts, tmp_path / "out", "--listening=false") == 0
    steps = pd.read_parquet(tmp_path / "out" / "trace" / STEPS_FILE)
    chosen = steps[steps["step"] % tiny_checkpoints.HORIZON == 0]["code"].value_counts()
    usage = pd.read_csv(tmp_path / "out" / "figures" / "code_usage.csv")
    assert usage["choices"].tolist() == chosen.tolist()  # the most frequent first
    assert all(" / " in label for label in usage["skill_code"])
    assert {int(label.split()[0]) for label in usage["skill_code"]} == set(chosen.index)
    for name in ("code_transitions", "skill_words_pmi", "actions_by_code", "code_usage_over_time"):
        assert set(pd.read_csv(tmp_path / "out" / "figures" / f"{name}.csv")["skill_code"]) == set(usage["skill_code"])
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert f"Left out: {1600 - len(chosen):,} codes that were never chosen." in page
    assert f"Codes in use: {len(chosen)} of 1600" in capsys.readouterr().out
    assert {path.stem for path in (tmp_path / "out" / "figures").glob("skill_[0-9]*.png")} == {
        f"skill_{code:03d}" for code in chosen.index
    }


def test_skills_that_end_before_their_horizon(
    symbolic: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    policy = tiny_checkpoints.lisa(symbolic, tmp_path / "lisa", horizon=4, termination_stride=1)
    assert run(monkeypatch, policy, tmp_path / "out", "--listening=false") == 0
    steps = pd.read_parquet(tmp_path / "out" / "trace" / STEPS_FILE).set_index(["episode", "step"])
    for example in frames.read(tmp_path / "out" / "trace"):
        followed = steps.loc[example.episode]["code"]
        assert (followed.loc[example.step : example.step + len(example.frames) - 2] == example.code).all()
        assert len(example.frames) <= 4 + 1
    usage = pd.read_csv(tmp_path / "out" / "figures" / "code_usage.csv")
    assert usage["choices"].sum() == len(steps)  # asked at every step
    assert re.search(r"A skill lasts: [1-4]\.\d steps", capsys.readouterr().out)
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "until it chooses another one, 4 steps at most" in page


def test_again_evaluates_nothing_and_gives_the_same(
    lisa: Path, made: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    shutil.copytree(made, tmp_path / "out")
    monkeypatch.setattr("lerobot_lisa.analysis.recording.record.load", None)
    (tmp_path / "out" / ".building_killed" / "figures").mkdir(parents=True)  # by a run that was killed
    assert run(monkeypatch, lisa, tmp_path / "out") == 0
    assert not list((tmp_path / "out").glob(".*"))
    assert (tmp_path / "out" / "report.html").read_bytes() == (made / "report.html").read_bytes()


def test_flat_policies_get_the_success_part(
    lang_dt: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(monkeypatch, lang_dt, tmp_path / "out") == 0
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "Lang-DT is flat: it acts on instructions and observations without skill codes" in page
    assert not list((tmp_path / "out" / "figures").glob("skill*"))
    assert "The instruction pays " in page
    assert (tmp_path / "out" / "figures" / "looks_grid.csv").is_file()
    assert "Success: " in capsys.readouterr().out


def test_continuous_skills_get_the_success_part(
    continuous_skills: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert run(monkeypatch, continuous_skills, tmp_path / "out") == 0
    assert "skills are continuous" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert not list((tmp_path / "out" / "figures").glob("skill*"))


def refused(output: str) -> str:
    *_, last = output.splitlines()
    assert last.startswith("error: ")
    return last


def test_what_is_wrong_is_said_in_one_line(
    lisa: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert run(monkeypatch, tmp_path / "absent", out) == 1
    assert "absent: no checkpoint (a folder with config.json) there" in refused(capsys.readouterr().err)
    assert run(monkeypatch, lisa, out, "--font=absent.ttf") == 1
    assert "--font=absent.ttf: no font that can be read" in refused(capsys.readouterr().err)
    assert run(monkeypatch, lisa, out, f"--dataset.root={tmp_path}") == 1
    assert f"--dataset.root={tmp_path}: no LeRobotDataset" in refused(capsys.readouterr().err)
    assert not out.exists()


def test_others_files_are_left_alone(
    lisa: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "figures").mkdir()
    (tmp_path / "figures" / "mine.png").write_text("precious")
    assert run(monkeypatch, lisa, tmp_path) == 1
    assert "figures was not made by this program" in refused(capsys.readouterr().err)
    assert [path.name for path in tmp_path.iterdir()] == ["figures"]


def test_a_file_that_is_no_font(tmp_path: Path) -> None:
    (tmp_path / "notes.ttf").write_text("no font")
    with pytest.raises(UserError, match=r"--font=.*notes\.ttf: no font that can be read"):
        check_font(tmp_path / "notes.ttf")


def test_training_data_that_are_gone_are_said_to_be(lisa: Path, symbolic: Path, tmp_path: Path) -> None:
    shutil.copytree(lisa, tmp_path / "lisa")
    config = tmp_path / "lisa" / "train_config.json"
    config.write_text(config.read_text().replace(str(symbolic), "/nowhere"))
    gone = training_data.find(str(tmp_path / "lisa"))
    assert gone.instructions is None
    assert gone.note == "The training data (/nowhere) are not here; --dataset.root says where."
    assert len(training_data.find(str(tmp_path / "lisa"), symbolic).instructions or ()) == 5
    config.unlink()
    assert "does not name its training data" in training_data.find(str(tmp_path / "lisa")).note


def test_training_on_some_episodes_saw_their_instructions_only(lisa: Path, symbolic: Path, tmp_path: Path) -> None:
    shutil.copytree(lisa, tmp_path / "lisa")
    config = tmp_path / "lisa" / "train_config.json"
    config.write_text(config.read_text().replace("null", "[1, 4]"))
    assert training_data.find(str(tmp_path / "lisa")).instructions == {"open a door", "go"}


@pytest.mark.parametrize(
    "named",
    ["", "[]", '{"dataset": [1]}', '{"dataset": {"root": null}}', '{"dataset": {"repo_id": "x", "episodes": ["0"]}}'],
)
def test_a_training_configuration_that_names_no_dataset(named: str, lisa: Path, tmp_path: Path) -> None:
    shutil.copytree(lisa, tmp_path / "lisa")
    (tmp_path / "lisa" / "train_config.json").write_text(named)
    assert "does not name its training data" in training_data.find(str(tmp_path / "lisa")).note


def test_training_data_that_cannot_be_the_checkpoints(lisa: Path, symbolic: Path, tmp_path: Path) -> None:
    shutil.copytree(lisa, tmp_path / "lisa")
    config = tmp_path / "lisa" / "train_config.json"
    config.write_text(config.read_text().replace("null", "[1000000000]"))
    with pytest.raises(UserError, match=r"is not the dataset of the checkpoint .* pass --dataset\.root"):
        training_data.find(str(tmp_path / "lisa"))
    (tmp_path / "data" / "meta").mkdir(parents=True)
    (tmp_path / "data" / "meta" / "info.json").write_text("[]")
    config.write_text(config.read_text().replace(str(symbolic), str(tmp_path / "data")))
    with pytest.raises(UserError, match="data is not the dataset of the checkpoint"):
        training_data.find(str(tmp_path / "lisa"))
