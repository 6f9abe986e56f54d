"""Recording: the trace is what LeRobot's evaluation did, whatever interrupted it; other folders are left alone."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from filelock import FileLock
from lerobot.scripts.lerobot_eval import eval_policy_all
from safetensors.torch import load_file, save_file

from lerobot_lisa.analysis.control.videos import VideoWriter
from lerobot_lisa.analysis.recording import record as record_module
from lerobot_lisa.analysis.recording import traces
from lerobot_lisa.analysis.recording.environment import Batch, Moment, hash_observation, render, step_successes
from lerobot_lisa.analysis.recording.evaluation import EvaluationConfig, load, load_config
from lerobot_lisa.analysis.recording.record import record
from lerobot_lisa.envs.babyai.config import BabyAIEnvConfig
from lerobot_lisa.errors import UserError

EPISODES, BATCH, STEPS = 5, 2, 12


def config(policy: Path, task: str = "GoToRedBallNoDists,GoToLocal", **changes: Any) -> EvaluationConfig:
    """Five episodes of at most twelve steps of each of two levels."""
    env = BabyAIEnvConfig(task=task, max_episode_steps=STEPS)
    settings = {"n_episodes": EPISODES, "batch_size": BATCH, **changes}
    return EvaluationConfig(env=env, policy=load_config(str(policy)), **settings)


@pytest.fixture(scope="module")
def recorded(lisa: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a trace."""
    folder = tmp_path_factory.mktemp("recorded") / "trace"
    record(config(lisa), folder)
    return folder


def test_the_successes_are_those_of_lerobot(lisa: Path, recorded: Path) -> None:
    cfg = config(lisa)
    policy, envs, pipelines = load(cfg)
    info = eval_policy_all(envs, policy, **pipelines, n_episodes=EPISODES, start_seed=cfg.seed)

    trace = traces.read(recorded)
    expected = {task["task_id"]: task["metrics"]["successes"] for task in info["per_task"]}
    found = {task: list(part["success"]) for task, part in trace.episodes.groupby("task_id")}
    assert found == expected
    assert list(trace.episodes["seed"]) == 2 * list(range(1000, 1000 + EPISODES))


def test_steps_and_episodes_agree(recorded: Path) -> None:
    trace = traces.read(recorded)
    for (group, task, number), steps in trace.steps.groupby(traces.KEY, observed=True):
        episode = trace.episodes.set_index(traces.KEY).loc[(group, task, number)]
        assert list(steps["step"]) == list(range(episode["steps"]))
        assert episode["steps"] <= STEPS
        assert set(steps["instruction"]) == {episode["instruction"]}
        assert set(steps["seed"]) == {episode["seed"]}
        assert steps["success"].any() == episode["success"]
        assert not steps["success"].iloc[:-1].any()
        assert all(steps["code"].iloc[start : start + 3].nunique() == 1 for start in range(0, len(steps), 3))
    assert trace.has_codes
    assert {len(action) for action in trace.steps["action"]} == {1}


def test_an_interrupted_evaluation_goes_on_to_the_same_trace(
    lisa: Path, recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run, calls = record_module.run_batch, 0

    def run_twice(*arguments: Any) -> tuple[pa.Table, pa.Table]:
        nonlocal calls
        calls += 1
        if calls == 3:
            raise KeyboardInterrupt
        return run(*arguments)

    monkeypatch.setattr(record_module, "run_batch", run_twice)
    with pytest.raises(KeyboardInterrupt):
        record(config(lisa), tmp_path / "trace")
    record(config(lisa), tmp_path / "trace")

    assert calls == 1 + 2 * -(-EPISODES // BATCH)
    for name in (traces.STEPS_FILE, traces.EPISODES_FILE):
        assert (tmp_path / "trace" / name).read_bytes() == (recorded / name).read_bytes()
    assert not (tmp_path / "trace" / "parts").exists()


def test_a_finished_trace_is_only_read(lisa: Path, recorded: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(record_module, "load", None)
    assert len(record(config(lisa), recorded).episodes) == 2 * EPISODES


def test_another_evaluation_is_refused(lisa: Path, recorded: Path) -> None:
    with pytest.raises(UserError, match=r"trace holds another evaluation \(seed was 1000, now 7\): choose another"):
        record(config(lisa, seed=7), recorded)
    with pytest.raises(UserError, match=r"another evaluation \(skill was None, now 3\)"):
        record(config(lisa), recorded, skill=3)


def test_a_folder_of_something_else_is_left_alone(lisa: Path, tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("precious")
    with pytest.raises(UserError, match="is in the way and was not made by this program"):
        record(config(lisa), tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


@pytest.mark.parametrize("mistake", [{"task": "GoToLocl"}, {"policy": ["--codebook_size=8"]}])
def test_a_mistake_leaves_nothing_behind(mistake: dict[str, Any], lisa: Path, tmp_path: Path) -> None:
    wrong = config(lisa, **{"task": "GoToLocal", **{key: mistake[key] for key in mistake if key == "task"}})
    wrong.policy = load_config(str(lisa), mistake.get("policy", []))
    with pytest.raises(UserError):
        record(wrong, tmp_path / "outputs" / "trace")
    assert not (tmp_path / "outputs").exists()
    record(config(lisa, task="GoToLocal"), tmp_path / "outputs" / "trace")


def test_a_mistake_that_shows_at_the_first_step_leaves_the_folder_free(lisa: Path, tmp_path: Path) -> None:
    class Refusing(Diary):
        def before_step(self, moment: Moment) -> None:
            raise UserError("another world")

    with pytest.raises(UserError, match="another world"):
        record(config(lisa, task="GoToLocal", seed=1), tmp_path / "trace", [Refusing()])
    record(config(lisa, task="GoToLocal", seed=2), tmp_path / "trace")


def test_other_weights_in_the_same_place_are_another_evaluation(lisa: Path, tmp_path: Path) -> None:
    policy, folder = Path(shutil.copytree(lisa, tmp_path / "lisa")), tmp_path / "trace"
    record(config(policy, task="GoToLocal", n_episodes=1), folder)
    weights = load_file(policy / "model.safetensors")
    save_file({name: value * 2 for name, value in weights.items()}, policy / "model.safetensors")
    with pytest.raises(UserError, match=r"another evaluation \(checkpoint\.sha256 was .*: choose another --output_dir"):
        record(config(policy, task="GoToLocal", n_episodes=1), folder)


def test_two_processes_do_not_share_a_folder(lisa: Path, recorded: Path) -> None:
    with FileLock(recorded / "lock"), pytest.raises(UserError, match="another process is recording there"):
        record(config(lisa), recorded)


def test_flat_policies_have_no_codes(lang_dt: Path, tmp_path: Path) -> None:
    trace = record(config(lang_dt, task="GoToLocal", n_episodes=1), tmp_path / "trace")
    assert not trace.has_codes
    assert len(trace.episodes) == 1


def test_processes_record_the_same(lisa: Path, tmp_path: Path) -> None:
    for asynchronous in (False, True):
        settings = {"task": "GoToLocal", "n_episodes": 2, "use_async_envs": asynchronous}
        record(config(lisa, **settings), tmp_path / str(asynchronous))
    same, other = (traces.read(tmp_path / name) for name in ("False", "True"))
    columns = ["episode", "step", "instruction", "code", "observation", "success"]
    assert same.steps[columns].equals(other.steps[columns])


class Diary:
    """Notes what a watcher is told."""

    def __init__(self) -> None:
        self.moments: list[Moment] = []
        self.shapes: set[tuple[int, ...]] = set()

    def before_step(self, moment: Moment) -> None:
        self.moments.append(moment)
        self.shapes.add(render(moment.env, moment.live[0]).shape)

    def after_rollout(self, moment: Moment) -> None:
        self.moments.append(moment)


def test_watchers_see_every_step(lisa: Path, tmp_path: Path) -> None:
    diary = Diary()
    trace = record(config(lisa, task="GoToLocal"), tmp_path / "trace", [diary])
    seen = [
        (moment.batch.first + index, moment.step, int(moment.codes[index]))
        for moment in diary.moments
        if moment.codes is not None
        for index in moment.live
    ]
    assert sorted(seen) == list(trace.steps[["episode", "step", "code"]].itertuples(index=False, name=None))
    assert sum(moment.codes is None for moment in diary.moments) == -(-EPISODES // BATCH)
    assert len(diary.shapes) == 1


def test_a_task_group_stays_in_its_folder(lisa: Path, tmp_path: Path) -> None:
    """A foreign environment may call its groups anything."""
    cfg = config(lisa, task="GoToLocal", n_episodes=1)
    evaluation = load(cfg)
    for name in ("../../escape", "/", "a" * 300, ".hidden", "a b"):
        folder = tmp_path / "deep" / "down" / str(len(name))
        films = VideoWriter(folder / "videos", 1)
        renamed = evaluation._replace(envs={name: evaluation.envs["babyai"]})
        trace = record(cfg, folder, [films], renamed)
        assert list(trace.episodes["group"]) == [name]
        (film,) = (folder / "videos").rglob("*.mp4")
        assert film.parent.parent == folder / "videos"
    assert [path.name for path in tmp_path.iterdir()] == ["deep"]
    assert [path.name for path in (tmp_path / "deep").iterdir()] == ["down"]
    assert len({Batch(name, 0, 0).folder for name in ("a/b", "a_b", "a b")}) == 3


def test_traces_that_are_none(tmp_path: Path, recorded: Path) -> None:
    with pytest.raises(UserError, match=r"steps\.parquet: no trace there"):
        traces.read(tmp_path)
    (tmp_path / traces.STEPS_FILE).write_bytes((recorded / traces.STEPS_FILE).read_bytes()[:-20])
    with pytest.raises(UserError, match=r"steps\.parquet: not a trace of lerobot_lisa"):
        traces.read(tmp_path)
    for name, schema in ((traces.STEPS_FILE, traces.STEPS), (traces.EPISODES_FILE, traces.EPISODES)):
        traces.write(schema.empty_table(), tmp_path / name, {})
    with pytest.raises(UserError, match="an empty trace, without a single step"):
        traces.read(tmp_path)


def test_checkpoints_that_are_none(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"--policy\.path=.*absent: no checkpoint"):
        load_config(str(tmp_path / "absent"))
    (tmp_path / "config.json").write_text(json.dumps({"type": "act"}))
    with pytest.raises(UserError, match=r"is a act policy: this reads .* lang_dt, lisa,"):
        load_config(str(tmp_path))


def test_numbers_out_of_range(lisa: Path) -> None:
    with pytest.raises(UserError, match="--n_episodes=0: give a number from 1 to 1,000,000"):
        config(lisa, n_episodes=0)


def test_observations_are_told_apart() -> None:
    pixels = np.zeros((2, 3, 3), np.uint8)
    pixels[1, 0, 0] = 1
    nested = {"pixels": {"front": pixels}, "state": np.zeros((2, 4))}
    assert hash_observation(nested, 0) != hash_observation(nested, 1)
    assert hash_observation(nested, 0) == hash_observation({"state": np.zeros((1, 4)), "pixels": {"front": pixels}}, 0)


def test_success_is_read_where_lerobot_reads_it() -> None:
    assert step_successes({"is_success": np.array([True, False])}, 2).tolist() == [True, False]
    assert step_successes({"final_info": {"is_success": [False, True]}, "is_success": [True, True]}, 2).tolist() == [
        False,
        True,
    ]
    assert step_successes({}, 2).tolist() == [False, False]
