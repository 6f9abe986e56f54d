"""Heard: policies whose listening is known, in real environments, by the real command."""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
import tiny_checkpoints
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.envs.configs import EnvConfig
from lerobot.envs.utils import freeze_after_episode_end
from scripted_policies import Deaf, Obedient, Scripted, Still, Wordwise, loading, obey

from lerobot_lisa.analysis.listening import demonstrators, heard
from lerobot_lisa.analysis.listening.command import main
from lerobot_lisa.analysis.listening.heard import NO_DEMONSTRATOR, Runs
from lerobot_lisa.analysis.listening.heard_figure import heard_plot
from lerobot_lisa.analysis.listening.other_words import DEAF, NOTHING, OTHER
from lerobot_lisa.analysis.recording import record as record_module
from lerobot_lisa.analysis.recording import traces
from lerobot_lisa.analysis.recording.evaluation import EvaluationConfig, load_config
from lerobot_lisa.code_version import commit
from lerobot_lisa.envs.babyai.config import BabyAIEnvConfig
from lerobot_lisa.envs.babyai.env import BabyAIEnv
from lerobot_lisa.errors import UserError

N, BATCH = 12, 5


def config(policy: Path, task: str = "GoToLocal", env: EnvConfig | None = None, **changes: Any) -> EvaluationConfig:
    env = env or BabyAIEnvConfig(task=task, max_episode_steps=25)
    settings = {"n_episodes": N, "batch_size": BATCH, **changes}
    return EvaluationConfig(env=env, policy=load_config(str(policy)), **settings)


def measure(
    policy: Path, folder: Path, scripted: type[Scripted], told: str = OTHER, made: Any = None, **changes: Any
) -> Runs:
    return heard.measure(config(policy, **changes), folder, told, load=loading(scripted, made))


# Policies whose listening is known.


@pytest.fixture(scope="module")
def obedient(lisa: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Runs, Path]:
    folder = tmp_path_factory.mktemp("obedient")
    return measure(lisa, folder, Obedient), folder


def own_goal_by_the_way(seed: int, told: str) -> bool:
    """Whether who obeys other words reaches the world's own goal all the same."""
    env = BabyAIEnv("GoToLocal")
    env.reset(seed=seed)
    return any(env.step(action)[4]["is_success"] for action in obey("GoToLocal", seed, told))


def test_who_obeys_is_heard_up_to_what_lies_on_the_way(obedient: tuple[Runs, Path]) -> None:
    runs, _ = obedient
    numbers = heard.listening(runs.pairs)

    assert runs.otherwise is not None
    told = runs.otherwise.episodes
    assert not (told["instruction"].astype(str) == runs.own.episodes["instruction"].astype(str)).any()
    floor = np.mean([own_goal_by_the_way(row.seed, row.instruction) for row in told.itertuples()])
    assert numbers.heard is not None
    assert numbers.success.percent == 100
    assert numbers.heard.points == pytest.approx(100 * (1 - floor))
    assert numbers.heard.points > 50
    assert numbers.heard.low < numbers.heard.points <= numbers.heard.high


def test_the_demonstrator_itself_has_spl_1_within_once_its_steps(obedient: tuple[Runs, Path]) -> None:
    numbers = heard.listening(obedient[0].pairs)

    assert numbers.spl is not None
    assert (numbers.spl.value, numbers.spl.low, numbers.spl.high, numbers.spl.episodes) == (1, 1, 1, N)
    assert numbers.budgets is not None
    assert [within.success.percent for within in numbers.budgets.values()] == [100, 100, 100]


def test_both_runs_start_in_the_same_worlds(obedient: tuple[Runs, Path]) -> None:
    runs, _ = obedient
    assert runs.otherwise is not None
    first, other = (trace.steps[trace.steps["step"] == 0] for trace in (runs.own, runs.otherwise))
    assert list(first["observation"]) == list(other["observation"])
    assert list(first["seed"]) == list(other["seed"])


@pytest.mark.parametrize("told", [OTHER, NOTHING])
def test_who_is_deaf_does_the_same_and_nothing_is_heard(told: str, lisa: Path, tmp_path: Path) -> None:
    runs = measure(lisa, tmp_path, Deaf, told)
    numbers = heard.listening(runs.pairs)

    assert runs.otherwise is not None
    same = ["episode", "step", "observation", "success"]
    pd.testing.assert_frame_equal(runs.own.steps[same], runs.otherwise.steps[same])
    assert numbers.heard is not None
    assert numbers.heard.points == 0
    assert numbers.heard.low < 0 < numbers.heard.high
    assert 0 < numbers.success.percent < 100
    assert numbers.spl is not None
    assert 0 < numbers.spl.value < 1
    assert numbers.budgets is not None
    rates = [within.success.percent for within in numbers.budgets.values()]
    assert rates == sorted(rates)
    assert rates[-1] <= numbers.success.percent
    assert {within.heard and within.heard.points for within in numbers.budgets.values()} == {0}


def test_a_lisa_with_a_single_code_hears_nothing(symbolic: Path, tmp_path: Path) -> None:
    """Its policy hears language through the code alone: whatever is said, drawn actions are the same."""
    policy = tiny_checkpoints.lisa(symbolic, tmp_path / "lisa", codebook_size=1, action_temperature=1.0)

    runs = heard.measure(config(policy), tmp_path / "out")

    assert runs.otherwise is not None
    assert set(runs.own.episodes["instruction"]) != set(runs.otherwise.episodes["instruction"])
    assert [list(action) for action in runs.own.steps["action"]] == [
        list(action) for action in runs.otherwise.steps["action"]
    ]
    numbers = heard.listening(runs.pairs).heard
    assert numbers is not None
    assert numbers.points == 0


def test_who_is_told_nothing_always_hears_the_same_word(lisa: Path, tmp_path: Path) -> None:
    made: list[Scripted] = []
    measure(lisa, tmp_path, Deaf, NOTHING, made, n_episodes=3, batch_size=3)

    assert {text for texts in made[0].told for text in texts} != {DEAF}
    assert {text for texts in made[1].told for text in texts} == {DEAF}


def test_what_was_recorded_before_is_used(obedient: tuple[Runs, Path], lisa: Path) -> None:
    runs, folder = obedient
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*.parquet")}

    again = measure(lisa, folder, Deaf)  # it would say something else, if it was asked

    pd.testing.assert_frame_equal(again.pairs, runs.pairs)
    assert {path: path.stat().st_mtime_ns for path in folder.rglob("*.parquet")} == before


@pytest.mark.parametrize("stop", [2, 5])
def test_an_interrupted_measurement_goes_on_to_the_same_numbers(
    stop: int, obedient: tuple[Runs, Path], lisa: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Three batches are told their own instruction, three another one."""
    run, calls = record_module.run_batch, 0

    def interrupted(*arguments: Any) -> tuple[pa.Table, pa.Table]:
        nonlocal calls
        calls += 1
        if calls == stop:
            raise KeyboardInterrupt
        return run(*arguments)

    monkeypatch.setattr(record_module, "run_batch", interrupted)
    with pytest.raises(KeyboardInterrupt):
        measure(lisa, tmp_path, Obedient)

    again = measure(lisa, tmp_path, Obedient)

    pd.testing.assert_frame_equal(again.pairs, obedient[0].pairs)
    assert heard.as_json(again) == heard.as_json(obedient[0])
    assert calls == 6 + 1


def test_the_demonstrator_is_asked_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from lerobot_lisa.analysis.listening import babyai

    episodes = pd.DataFrame({"group": "babyai", "task_id": 0, "episode": range(4), "seed": range(1000, 1004)})
    env, find, asked = BabyAIEnvConfig(task="GoToLocal"), babyai.demonstrator_steps, []

    def ask(name: str, seed: int) -> int | None:
        if len(asked) == 2:
            asked.append(-1)
            raise KeyboardInterrupt
        asked.append(seed)
        return find(name, seed)

    expected = [find("GoToLocal", seed) for seed in range(1000, 1004)]
    monkeypatch.setattr(babyai, "demonstrator_steps", ask)
    with pytest.raises(KeyboardInterrupt):
        demonstrators.demonstrator_steps(env, episodes, tmp_path)
    steps = demonstrators.demonstrator_steps(env, episodes, tmp_path)

    assert steps is not None
    assert list(steps) == expected
    assert asked == [1000, 1001, -1, 1002, 1003]


def test_several_levels_stand_beside_each_other(lisa: Path, tmp_path: Path) -> None:
    """One of them always says the same: nothing else can be told there."""
    runs = measure(lisa, tmp_path, Deaf, task="GoToLocal,GoToRedBall", n_episodes=6, batch_size=6)
    counts = heard.table(runs).set_index(["number", "part"])["episodes"]

    assert counts["success"].to_dict() == {"GoToLocal": 6, "GoToRedBall": 6, "overall": 12}
    assert counts["SPL"].to_dict() == {"GoToLocal": 6, "GoToRedBall": 6, "overall": 12}
    assert counts["heard"].to_dict() == {"GoToLocal": 6, "overall": 6}


def test_the_figure_ends_at_the_success_rates(obedient: tuple[Runs, Path]) -> None:
    runs, _ = obedient
    numbers = heard.listening(runs.pairs)
    drawn = heard_plot(runs, "12 episodes")

    own, other = drawn.figure.axes[0].get_lines()[:2]
    assert own.get_ydata()[-1] == numbers.success.percent
    assert numbers.told_otherwise is not None
    assert max(other.get_ydata(), default=0) == pytest.approx(numbers.told_otherwise.percent)
    assert {name for name, *_ in heard.key_numbers(runs)} == {"Heard", "SPL"}


def test_a_policy_that_never_succeeds_gets_its_numbers_and_its_figure(lisa: Path, tmp_path: Path) -> None:
    runs = measure(lisa, tmp_path, Still, n_episodes=3, batch_size=3)
    numbers = heard.listening(runs.pairs)

    assert numbers.spl is not None
    assert (numbers.success.percent, numbers.spl.value) == (0, 0)
    assert [list(line.get_ydata()) for line in heard_plot(runs, "3 episodes").figure.axes[0].get_lines()] == [[0], [0]]


# Anybody's environment.


class Doors(gym.Env):
    """A corridor of doors: whoever goes to this task's door first succeeds."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": 10}  # noqa: RUF012
    observation_space = gym.spaces.Dict(
        {
            "grid": gym.spaces.Box(0, 255, (147,), np.uint8),
            "direction": gym.spaces.Box(0, 3, (1,), np.uint8),
        }
    )
    action_space = gym.spaces.Discrete(7)
    _max_episode_steps = 2

    def __init__(self, door: int) -> None:
        self._door, self._steps = door, 0
        self.task, self.task_description = f"door{door}", f"go to door {door}"

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        super().reset(seed=seed)
        self._steps = 0
        return self._observe(), {"is_success": False}

    def step(self, action: Any) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        self._steps += 1
        success = round(float(np.ravel(action)[0])) == self._door
        return self._observe(), float(success), success, self._steps == 2, {"is_success": success}

    def _observe(self) -> dict[str, np.ndarray]:
        return {"grid": np.zeros(147, np.uint8), "direction": np.zeros(1, np.uint8)}


NAMES = {"grid": "observation.grid", "direction": "observation.direction", "action": "action"}


@EnvConfig.register_subclass("doors")
@dataclass
class DoorsConfig(EnvConfig):
    """Somebody else's environment, of as many tasks as it has doors."""

    task: str = "corridor"
    fps: int = 10
    doors: int = 3
    features: dict[str, PolicyFeature] = field(
        default_factory=lambda: {
            "grid": PolicyFeature(type=FeatureType.ENV, shape=(147,)),
            "direction": PolicyFeature(type=FeatureType.ENV, shape=(1,)),
            "action": PolicyFeature(type=FeatureType.ACTION, shape=(1,)),
        }
    )
    features_map: dict[str, str] = field(default_factory=lambda: dict(NAMES))

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        return {}

    def create_envs(self, n_envs: int, use_async_envs: bool = False) -> dict[str, dict[int, Any]]:
        def side_by_side(door: int) -> gym.vector.SyncVectorEnv:
            made = [freeze_after_episode_end(lambda: Doors(door))] * n_envs
            return gym.vector.SyncVectorEnv(made, autoreset_mode=gym.vector.AutoresetMode.NEXT_STEP)

        return {"corridor": {door: side_by_side(door) for door in range(1, self.doors + 1)}}


def test_anybodys_environment_of_several_tasks(lisa: Path, tmp_path: Path) -> None:
    runs = measure(lisa, tmp_path, Wordwise, env=DoorsConfig(), n_episodes=4, batch_size=3)
    numbers = heard.listening(runs.pairs)

    assert runs.otherwise is not None
    told = runs.otherwise.episodes.groupby("task_id")["instruction"].agg(lambda texts: set(map(str, texts)))
    assert told[1] == {"go to door 2", "go to door 3"}
    assert numbers.heard is not None
    assert (numbers.heard.points, numbers.heard.episodes) == (100, 12)
    assert (numbers.spl, numbers.budgets) == (None, None)
    assert any(NO_DEMONSTRATOR in line for line in heard.lines(runs))
    assert set(heard_plot(runs, "12 episodes").table["number"]) == {"success", "told otherwise", "heard"}


def test_with_one_task_nothing_can_be_told_in_its_place(lisa: Path, tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"--env\.type=doors offers one task here"):
        measure(lisa, tmp_path / "out", Wordwise, env=DoorsConfig(doors=1), n_episodes=2)
    assert not (tmp_path / "out").exists()
    runs = measure(lisa, tmp_path / "out", Wordwise, NOTHING, env=DoorsConfig(doors=1), n_episodes=2)
    heard_numbers = heard.listening(runs.pairs).heard
    assert heard_numbers is not None
    assert heard_numbers.points == 100


# The command.


def diagnose(monkeypatch: pytest.MonkeyPatch, policy: Path, output: Path, *options: str) -> int:
    arguments = ["heard", f"--policy.path={policy}", f"--output_dir={output}", *options]
    monkeypatch.setattr("sys.argv", ["lisa-diagnose", *arguments])
    return main()


BABYAI = ("--env.type=babyai", "--env.task=GoToLocal", "--env.max_episode_steps=8", "--n_episodes=6")


@pytest.mark.parametrize("kind", ["lisa", "lang_dt", "babyai_rnn", "lang_bc"])
def test_heard_in_babyai(
    kind: str,
    tmp_path: Path,
    request: pytest.FixtureRequest,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    policy = request.getfixturevalue(kind)
    assert diagnose(monkeypatch, policy, tmp_path, *BABYAI, "--batch_size=4") == 0

    printed = capsys.readouterr().out
    content = json.loads((tmp_path / "heard.json").read_text())
    overall = content["rates"]["overall"]
    assert overall["success"]["episodes"] == overall["heard"]["episodes"] == 6
    assert set(overall["budgets"]) == {"1", "2", "4"}
    assert content["evaluation"]["seed"] == 1000
    assert content["made"]["commit"] == commit()
    assert content["made"]["command"].startswith("lisa-diagnose heard --policy.path=")
    for said in ("heard", "SPL", "success within 4 x the demonstrator's steps", heard.READING):
        assert said in printed
    assert ("first skill code" in printed) == (kind == "lisa")
    assert (tmp_path / "heard.png").is_file()
    assert diagnose(monkeypatch, policy, tmp_path, *BABYAI, "--batch_size=4") == 0
    assert printed.endswith(capsys.readouterr().out)  # from what was recorded; the policy is not loaded again


def test_heard_in_lorel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, tabletop: Path) -> None:
    assert diagnose(monkeypatch, tabletop, tmp_path, "--env.type=lorel", "--n_episodes=2") == 0

    trace = traces.read(tmp_path / "heard" / "told_other")
    told = trace.episodes.groupby("task_id")["instruction"].agg(list)
    assert len(told) == 6
    assert all(len(set(texts)) == 2 for texts in told)  # another task in every episode
    rows = pd.read_csv(tmp_path / "heard.csv").set_index(["number", "part"])
    assert rows.loc[("heard", "overall"), "episodes"] == 12
    assert "SPL" not in rows.index


def test_other_wordings_of_a_task_are_no_other_task(tmp_path: Path, tabletop: Path) -> None:
    from lerobot_lisa.analysis.listening.other_words import other_words
    from lerobot_lisa.envs.lorel.config import LorelEnvConfig
    from lerobot_lisa.envs.lorel.groups import find_groups

    rows = [
        {"group": group, "task_id": task_id, "episode": 0, "seed": 1000, "instruction": task.instruction}
        for group, tasks in find_groups("rephrasals").items()
        for task_id, task in enumerate(tasks)
    ]
    told = other_words(OTHER, LorelEnvConfig(task="rephrasals"), pd.DataFrame(rows))

    means = {task.instruction: task.parts for tasks in find_groups("rephrasals").values() for task in tasks}
    assert sum(map(len, told.values())) == 77
    for row in rows:
        assert means[told[row["group"], row["task_id"]][1000]] != means[row["instruction"]]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--env.type=babyai", "--told=both"], "--told=both: choose one of: other, nothing"),
        (["--env.type=lorel", "--env.task=close drawer"], "--env.type=lorel offers one task here"),
        (["--env.type=babyai", "--env.task=GoToRedBall", "--env.max_episode_steps=3"], "there is nothing else to tell"),
    ],
)
def test_mistakes_take_one_line(
    options: list[str],
    said: str,
    tabletop: Path,
    lisa: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    policy = tabletop if "--env.type=lorel" in options else lisa
    assert diagnose(monkeypatch, policy, tmp_path / "out", *options, "--n_episodes=2") == 1

    printed = capsys.readouterr().err.strip().splitlines()[-1]
    assert printed.startswith("error: ")
    assert said in printed
