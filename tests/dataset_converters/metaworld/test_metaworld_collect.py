"""Demonstrations of Meta-World: what LeRobot's environment shows, successes only, the same bytes however made."""

import hashlib
import os
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import programs
import pytest
import torch

if find_spec("mujoco") is None or find_spec("metaworld") is None:
    pytest.skip("Meta-World is not installed", allow_module_level=True)

from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.envs.configs import MetaworldEnv as MetaworldConfig
from lerobot.envs.utils import env_to_policy_features, preprocess_observation

from dataset_converters.metaworld import collect as collect_module
from dataset_converters.metaworld import shards
from dataset_converters.metaworld.cli import main
from dataset_converters.metaworld.collect import CollectResult, CollectSettings, collect
from dataset_converters.metaworld.expert import world
from dataset_converters.metaworld.shards import Shard, make_states
from lerobot_lisa.envs.engine import check_drawing
from lerobot_lisa.envs.metaworld_states.tasks import find_tasks, instructions
from lerobot_lisa.episodes.pictures import resize
from lerobot_lisa.errors import UserError

SHORT = ("stick-push-v3", "coffee-button-v3")  # the experts need some 30 steps
SMALL = 48


@pytest.fixture(scope="module")
def can_draw() -> None:
    try:
        check_drawing("Meta-World", "--states-only")
    except UserError as error:
        pytest.skip(str(error))


def settings(root: Path, **changes: Any) -> CollectSettings:
    given = {"tasks": SHORT, "episodes": 7, "root": root, "repo_id": "me/tasks", "pictures": False}
    return CollectSettings(**{**given, **changes})


def tree_hash(root: Path) -> dict[str, str]:
    return {
        str(p.relative_to(root)): hashlib.sha256(p.read_bytes()).hexdigest() for p in root.rglob("*") if p.is_file()
    }


@pytest.fixture(scope="module")
def states(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, CollectResult]:
    root = tmp_path_factory.mktemp("collected") / "tasks"
    return root, collect(settings(root))


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory, can_draw: None) -> Path:
    """One episode, as the environment shows it."""
    root = tmp_path_factory.mktemp("drawn") / "tasks"
    collect(settings(root, tasks=SHORT[:1], episodes=1, pictures=True))
    return root


@pytest.mark.slow
def test_a_policy_is_shown_the_same_by_lerobots_environment(drawn: Path) -> None:
    """Names, shapes, types and values, step after step, until the last action succeeds."""
    dataset = LeRobotDataset("me/tasks", root=drawn)
    config = MetaworldConfig()
    wanted = env_to_policy_features(config)
    with world(SHORT[0]) as env:
        observation, _ = env.reset(seed=dataset.meta.episodes[0]["seed"])
        for frame in dataset:
            shown = preprocess_observation({key: value[None] for key, value in observation.items()})
            for key, feature in wanted.items():
                assert tuple(frame[key].shape) == feature.shape
            for key, value in shown.items():
                assert frame[key].dtype == value.dtype
                assert torch.equal(frame[key], value[0])
            assert frame["task"] == env.task_description
            observation, _, ended, _, info = env.step(frame["action"].numpy())
            assert info["is_success"] == ended == (frame["frame_index"] == len(dataset) - 1)
    assert dataset.fps == config.fps
    assert wanted.keys() == {key for key in dataset.features if key.startswith(("observation", "action"))}


@pytest.mark.slow
def test_small_pictures_are_what_our_policies_make_of_those_in_a_rollout(
    drawn: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["--tasks", SHORT[0], "--episodes", "1", "--workers", "1", "--repo-id", "me/tasks"]
    assert main(["collect", *arguments, "--image-size", str(SMALL), "--root", str(tmp_path / "small")]) == 0
    assert f" --policy.image_size={SMALL} " in capsys.readouterr().out  # of what to type next
    large, small = (LeRobotDataset("me/tasks", root=root) for root in (drawn, tmp_path / "small"))

    assert small.features["observation.image"]["shape"] == (SMALL, SMALL, 3)
    for number in (0, len(large) - 1):
        picture = small[number]["observation.image"]
        assert torch.equal((picture * 255).round().byte(), resize(large[number]["observation.image"], SMALL))
    assert f"{SMALL} x {SMALL} pixels" in (tmp_path / "small/README.md").read_text()


def test_tasks_alternate_and_are_told_as_lerobot_tells_them(states: tuple[Path, CollectResult]) -> None:
    root, result = states
    rows = list(LeRobotDataset("me/tasks", root=root).meta.episodes)

    assert [row["metaworld_task"] for row in rows] == list(SHORT) * 7
    assert all(row["tasks"] == [instructions()[row["metaworld_task"]]] for row in rows)
    assert all(row["seed"] >= 1_000_000 for row in rows)
    assert {task: len(seeds) for task, seeds in result.seeds.items()} == dict.fromkeys(SHORT, 7)
    assert (result.totals.episodes, result.failures) == (14, 0)


def test_actions_are_those_that_are_executed(states: tuple[Path, CollectResult]) -> None:
    actions = np.stack(LeRobotDataset("me/tasks", root=states[0]).hf_dataset.with_format("numpy")[:]["action"])
    assert actions.dtype == np.float32
    assert np.abs(actions).max() == 1  # experts ask for more


def test_failures_are_left_out_counted_and_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["--tasks", "push-v3", "--episodes", "10", "--states-only", "--workers", "1", "--repo-id", "me/push"]
    assert main(["collect", *arguments, "--root", str(tmp_path / "push")]) == 0

    said = capsys.readouterr().out
    rows = list(LeRobotDataset("me/push", root=tmp_path / "push").meta.episodes)
    missing = set(range(1_000_000, 1_000_011)) - {row["seed"] for row in rows}
    assert len(rows) == 10
    assert len(missing) == 1  # with these versions of metaworld and mujoco
    named = f"push-v3: seeds 1000000 to 1000010, 1 failures left out ({missing.pop()})"
    assert named in said
    assert named.removeprefix("push-v3: seeds ") in (tmp_path / "push/README.md").read_text()
    assert "1 failures of the experts left out" in said


def test_two_workers_make_the_same_bytes(states: tuple[Path, CollectResult], tmp_path: Path) -> None:
    collect(settings(tmp_path / "tasks", workers=2))
    assert tree_hash(tmp_path / "tasks") == tree_hash(states[0])


def test_an_interrupted_run_goes_on_and_makes_the_same_bytes(
    states: tuple[Path, CollectResult], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where it was to be a smaller one."""
    made: list[Shard] = []

    def stop_at_the_third(folder: Path, shard: Shard) -> list[int]:
        if len(made) == 2:
            raise KeyboardInterrupt
        made.append(shard)
        return make_states(folder, shard)

    monkeypatch.setattr(collect_module, "make_states", stop_at_the_third)
    with pytest.raises(KeyboardInterrupt):
        collect(settings(tmp_path / "tasks", episodes=5, tasks=(SHORT[0], "reach-v3", SHORT[1])))
    kept = {path: path.stat().st_mtime_ns for path in (tmp_path / "tasks.partial/shards").glob("*.npz")}
    assert len(kept) == 2
    monkeypatch.setattr(collect_module, "make_states", make_states)
    with pytest.raises(UserError, match="other settings"):
        collect(settings(tmp_path / "tasks", first_seed=2_000_000))
    assert {path: path.stat().st_mtime_ns for path in kept} == kept
    collect(settings(tmp_path / "tasks"))
    assert tree_hash(tmp_path / "tasks") == tree_hash(states[0])


def test_an_expert_that_always_fails_ends_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shards, "demonstrate", lambda env, seed: None)
    with pytest.raises(UserError, match=r"^the expert failed all of its first 56 episodes of stick-push-v3; leave it"):
        collect(settings(tmp_path / "tasks"))


def test_benchmarks_groups_and_names() -> None:
    ten, fifty = find_tasks("MT10"), find_tasks("mt50")
    assert (len(ten), len(fifty), set(fifty)) == (10, 50, set(instructions()))
    assert set(ten) < set(fifty)
    assert find_tasks("metaworld-reach-v3, reach-v3,hard")[:2] == ("reach-v3", "assembly-v3")
    assert len(find_tasks("easy,medium,hard,very_hard")) == 50


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--first-seed", "1000"], "reserved"),
        (["--episodes", "0"], "must be 1 to"),
        (["--workers", "0"], "at least 1"),
        (["--repo-id", "nobody"], "user/name"),
        (["--tasks", "reach-v2"], "'reach-v2' is no task of Meta-World: did you mean reach-v3"),
        (["--tasks", "MT11"], "did you mean MT10"),
        (["--tasks", " , "], "--tasks is ' , ': name MT10, or tasks such as reach-v3"),
        (["--image-size", "8"], "--image-size 8: give a whole number from 16 to 480"),
        (["--image-size", "500"], "from 16 to 480"),
        (["--root", "/proc/here/data", "--states-only"], "/proc/here/data: "),
    ],
)
def test_bad_arguments_are_one_line_and_leave_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], message: str
) -> None:
    given = ["--tasks", "reach-v3", "--episodes", "5", "--root", str(tmp_path / "d"), "--repo-id", "me/d"]
    assert main(["collect", *given, "--workers", "1", *arguments]) == 1
    error = capsys.readouterr().err
    assert message in error
    assert error.startswith("error: ")
    assert error.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_without_gl_one_line_says_what_to_install_and_states_do_without(tmp_path: Path) -> None:
    """Nothing is simulated before it is known that it can be drawn."""
    command = ["python", "-m", "dataset_converters.metaworld", "collect", "--tasks", SHORT[0], "--episodes", "1"]
    command += ["--root", str(tmp_path / "d"), "--repo-id", "me/d", "--workers", "1"]
    env = {**os.environ, "MUJOCO_GL": "disable"}

    done = programs.run(*command, env=env)
    assert (done.returncode, done.stdout, list(tmp_path.iterdir())) == (1, "", [])
    assert done.stderr.startswith("error: cannot draw Meta-World (MUJOCO_GL is disable: ")
    assert "apt-get install libegl1 libgl1-mesa-dri" in done.stderr
    assert done.stderr.rstrip().endswith("or use states only (--states-only)")
    assert done.stderr.count("\n") == 1
    done = programs.run(*command, "--states-only", env=env)
    assert done.returncode == 0, done.stderr
    assert LeRobotDataset("me/d", root=tmp_path / "d").num_episodes == 1
