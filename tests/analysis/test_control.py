"""Steered rollouts: `lisa-rollout` from the command line, in LeRobot's own evaluation."""

import shutil
from pathlib import Path

import av
import numpy as np
import pandas as pd
import pytest
import tiny_checkpoints
from tiny_checkpoints import CODES

from lerobot_lisa.analysis.control import matrix
from lerobot_lisa.analysis.control.rollout import as_plan, main
from lerobot_lisa.analysis.control.videos import captioned
from lerobot_lisa.analysis.recording import traces
from lerobot_lisa.analysis.recording.evaluation import EvaluationConfig, load, load_config, steered
from lerobot_lisa.envs.babyai.config import BabyAIEnvConfig
from lerobot_lisa.errors import UserError

STEPS = 8


def rollout(monkeypatch: pytest.MonkeyPatch, policy: Path, output: Path, *options: str) -> int:
    """`lisa-rollout` in a small level; returns the exit code."""
    level = ["--env.type=babyai", "--env.task=GoToRedBallNoDists", f"--env.max_episode_steps={STEPS}"]
    arguments = [f"--policy.path={policy}", *level, "--n_episodes=3", "--batch_size=2", f"--output_dir={output}"]
    monkeypatch.setattr("sys.argv", ["lisa-rollout", *arguments, *options])
    return main()


def codes_of(output: Path) -> list[list[int]]:
    """Skill codes of each recorded episode."""
    return [list(part["code"]) for _, part in traces.read(output).steps.groupby("episode")]


@pytest.fixture
def output(tmp_path: Path) -> Path:
    return tmp_path / "rollout"


def test_one_code_for_the_whole_episode(
    lisa: Path, output: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert rollout(monkeypatch, lisa, output, "--skill=4", "--n_videos=0") == 0

    assert all(set(codes) == {4} for codes in codes_of(output))
    printed = capsys.readouterr().out
    assert "seed 1002" in printed
    assert "4*" in printed
    assert "% success" in printed


def test_a_plan(lisa: Path, output: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert rollout(monkeypatch, lisa, output, "--plan=4*2,1*3,?", "--n_videos=0") == 0

    for codes in codes_of(output):
        assert codes[:5] == [4, 4, 1, 1, 1][: len(codes)]
        assert all(len(set(codes[5 + start : 8 + start])) == 1 for start in range(0, len(codes) - 5, 3))


def test_the_policy_goes_its_own_way_without_a_plan(lisa: Path, output: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A plan of what it chose gives the same actions."""
    assert rollout(monkeypatch, lisa, output, "--n_videos=0") == 0
    own = traces.read(output).steps
    plan = as_plan(own[own["episode"] == 0]["code"])

    assert rollout(monkeypatch, lisa, output.with_name("again"), f"--plan={plan}", "--n_videos=0") == 0

    again = traces.read(output.with_name("again")).steps
    first, repeated = (steps[steps["episode"] == 0] for steps in (own, again))
    assert [list(action) for action in first["action"]] == [list(action) for action in repeated["action"]]


def test_videos_show_the_code(lisa: Path, output: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert rollout(monkeypatch, lisa, output, "--skill=2", "--n_videos=1") == 0

    videos = sorted((output / "videos").rglob("*.mp4"))
    assert [video.relative_to(output).as_posix() for video in videos] == ["videos/babyai_0/episode_0.mp4"]
    with av.open(str(videos[0])) as film:
        frames = [frame.to_ndarray(format="rgb24") for frame in film.decode(video=0)]
    assert len(frames) == len(codes_of(output)[0]) + 1  # and one of how it ended
    assert frames[0][:18].mean() > 200  # black on white above the picture
    assert frames[0][:18].min() < 100


def test_videos_that_are_gone_are_said_to_be(
    lisa: Path, output: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert rollout(monkeypatch, lisa, output, "--n_videos=1") == 0
    shutil.rmtree(output / "videos")
    assert rollout(monkeypatch, lisa, output, "--n_videos=1") == 1
    assert capsys.readouterr().err.splitlines()[-1].startswith(f"error: {output / 'videos'} is gone")


def test_captions_leave_the_picture_as_it_is() -> None:
    frame = np.random.default_rng(0).integers(0, 256, (20, 30, 3), dtype=np.uint8)

    assert np.array_equal(captioned(frame, "step 1")[18:], frame)


def test_an_equal_run_is_not_repeated_and_another_one_refused(
    lisa: Path, output: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    rollout(monkeypatch, lisa, output, "--skill=2", "--n_videos=0")
    written = (output / traces.STEPS_FILE).stat().st_mtime_ns

    assert rollout(monkeypatch, lisa, output, "--skill=2", "--n_videos=0") == 0
    assert (output / traces.STEPS_FILE).stat().st_mtime_ns == written
    assert rollout(monkeypatch, lisa, output, "--skill=3", "--n_videos=0") == 1
    assert "skill_plan was '2', now '3'" in capsys.readouterr().err


def test_a_matrix_of_tasks_and_codes(
    lisa: Path, output: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert rollout(monkeypatch, lisa, output, "--skill=all", "--n_episodes=1") == 0

    for name in ("skill_matrix", "skill_starts"):
        assert {path.suffix for path in output.glob(f"{name}.*")} == {".png", ".pdf", ".csv"}
    starts = pd.read_csv(output / "skill_starts.csv", dtype={"code": str})
    assert list(starts.columns) == ["task", "seed", "success", "code"]
    assert set(starts["seed"]) == {1000}
    followed = {path.name: traces.read(path).episodes["success"].item() for path in sorted(output.glob("skill_*/"))}
    said = {f"skill_{row.code.split()[0]}": row.success for row in starts.itertuples()}
    assert said == followed
    table = pd.read_csv(output / "skill_matrix.csv", dtype={"code": str})
    assert [label.split()[0] for label in table["code"]] == ["own", *map(str, range(CODES))]
    assert set(table["episodes"]) == {1}
    assert set(codes_of(output / "skill_3")[0]) == {3}
    assert "GoToRedBallNoDists: best alone is code" in capsys.readouterr().out


def test_of_many_codes_the_matrix_has_those_that_the_policy_chose(
    symbolic: Path, output: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = {"n_code_parts": 2, "codebook_size": 40}
    policy = tiny_checkpoints.lisa(symbolic, output.with_name("two_parts"), **settings)
    assert rollout(monkeypatch, policy, output, "--skill=all", "--n_episodes=1") == 0

    chosen = set(codes_of(output / "skill_own")[0])
    assert {path.name for path in output.glob("skill_*") if path.is_dir()} == {
        "skill_own",
        *(f"skill_{code}" for code in chosen),
    }
    table = pd.read_csv(output / "skill_matrix.csv")
    assert set(table["left_out"]) == {1600 - len(chosen)}
    assert all(" / " in label for label in table["code"][1:])


def test_the_matrix_has_random_actions_beside_the_policys_own_codes() -> None:
    rows = [
        ("open", "own", 50.0, 5.0),
        ("open", "0", 20.0, 5.0),
        ("shut", "own", 90.0, 60.0),
        ("shut", "0", 95.0, 60.0),
    ]
    table = pd.DataFrame(rows, columns=["task", "code", "percent", "random_actions"])
    table = table.assign(successes=1, episodes=2, low=0.0, high=100.0)

    drawn = matrix.matrix_plot(table, "n = 2")

    heat = drawn.figure.axes[0]
    assert [label.get_text() for label in heat.get_xticklabels()] == ["own", "rand.", "0"]
    assert [label.get_text() for label in heat.get_yticklabels()] == ["open", "shut"]
    assert heat.images[0].get_array().tolist() == [[50, 5, 20], [90, 60, 95]]
    assert list(matrix.said(table))[1].startswith("shut: best alone is code 0, 95.0 %")


def test_every_start_has_a_row_in_the_order_in_which_it_was_run() -> None:
    rows = [
        (task, seed, task == code or (code == "own" and seed == 1001), code)
        for code in ("own", "shut", "open")
        for task in ("open", "shut")
        for seed in (1000, 1001)
    ]
    drawn = matrix.starts_plot(pd.DataFrame(rows, columns=["task", "seed", "success", "code"]), "n = 2")

    heat = drawn.figure.axes[0]
    assert [label.get_text() for label in heat.get_xticklabels()] == ["own", "shut", "open"]
    assert [label.get_text() for label in heat.get_yticklabels()] == [
        "open, seed 1000", "open, seed 1001", "shut, seed 1000", "shut, seed 1001"
    ]  # fmt: skip
    assert heat.images[0].get_array().tolist() == [[0, 0, 1], [1, 0, 1], [0, 1, 0], [1, 1, 0]]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--skill=5"], f"codes 0 to {CODES - 1}"),
        (["--skill=1*2"], "give one skill code"),
        (["--skill=first"], "first"),
        (["--skill=1", "--plan=1*2"], "exclude each other"),
        (["--plan=1*2;3"], "is no part of a plan"),
        (["--n_videos=-1"], "--n_videos"),
        (["--n_episodes=0"], "--n_episodes"),
    ],
)
def test_mistakes_take_one_line(
    options: list[str],
    said: str,
    lisa: Path,
    output: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert rollout(monkeypatch, lisa, output, *options) == 1

    printed = capsys.readouterr().err.strip().splitlines()[-1]
    assert printed.startswith("error: ")
    assert said in printed
    assert not output.exists()


@pytest.mark.parametrize("option", ["--skill=1", "--skill=all", "--plan=1*2"])
def test_only_lisa_has_codes(
    option: str, lang_dt: Path, output: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert rollout(monkeypatch, lang_dt, output, option) == 1

    assert "is a lang_dt policy: only lisa policies have skill codes" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("option", "said"),
    [
        ("--skill=1", "has continuous skills: there are no skill codes"),
        ("--skill=all", "has continuous skills: there are no skill codes"),
        (
            "--policy.skill_plan=1*2",
            "skill plan '1*2': this policy has no skill codes to follow: its skills are continuous",
        ),
    ],
)
def test_continuous_skills_cannot_be_chosen(
    option: str,
    said: str,
    continuous_skills: Path,
    output: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert rollout(monkeypatch, continuous_skills, output, option) == 1

    assert said in capsys.readouterr().err


def test_lang_dt_can_be_filmed(lang_dt: Path, output: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert rollout(monkeypatch, lang_dt, output, "--n_videos=1", "--n_episodes=1") == 0

    assert len(list(output.rglob("*.mp4"))) == 1


def test_steering_leaves_the_original_alone(lisa: Path) -> None:
    config = EvaluationConfig(env=BabyAIEnvConfig(), policy=load_config(str(lisa)))

    assert steered(config, "1").policy.skill_plan == "1"
    assert config.policy.skill_plan is None
    with pytest.raises(UserError, match="no skill code 9"):
        load(steered(config, "9"))
