"""Diagnoses beside heard: worlds with two goals, the paper's affordance test, other wordings, and the command line."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from lerobot_lisa.analysis.listening import affordance, reactions, rephrase, swap
from lerobot_lisa.analysis.listening.affordance_figure import affordance_plot
from lerobot_lisa.analysis.listening.command import main
from lerobot_lisa.analysis.listening.meanings import MEANINGS, OTHER_OBJECT, OTHER_VERB, SAME, instructions_about
from lerobot_lisa.analysis.listening.swap import ToldRun
from lerobot_lisa.analysis.listening.swapped_babyai import SwappedBabyAI
from lerobot_lisa.analysis.listening.two_goals import GOALS
from lerobot_lisa.analysis.recording.traces import Trace
from lerobot_lisa.envs.babyai.env import BabyAIEnv
from lerobot_lisa.envs.lorel.suites import KINDS, SUITES

# Worlds with two goals.


@pytest.mark.parametrize("level", ["GoToLocal", "GoToSeq", "BossLevel"])
def test_both_babyai_worlds_are_the_worlds_of_evaluation(level: str) -> None:
    own, plain = SwappedBabyAI(level, "original"), BabyAIEnv(level)
    other = SwappedBabyAI(level, "other")
    for seed in range(1000, 1010):
        expected, _ = plain.reset(seed=seed)
        for env in (own, other):
            observation, _ = env.reset(seed=seed)
            assert all(np.array_equal(observation[key], expected[key]) for key in expected)
        assert own.task_description == plain.task_description
        assert other.task_description != plain.task_description


def follow_bot(env: SwappedBabyAI, seed: int) -> tuple[bool, list[int]]:
    """Let the demonstrating bot do what the world is told; returns success and the actions."""
    from minigrid.utils.baby_ai_bot import BabyAIBot

    env.reset(seed=seed)
    bot, actions, ended, info = BabyAIBot(env._level), [], False, {}
    while not ended:
        actions.append(int(bot.replan(actions[-1] if actions else None)))
        _, _, terminated, truncated, info = env.step(actions[-1])
        ended = terminated or truncated
    return info["is_success"], actions


@pytest.mark.parametrize("level", ["GoToLocal", "PickupLoc", "BossLevel"])
def test_the_told_goal_can_be_reached_and_is_noticed(level: str) -> None:
    for told in GOALS:
        env = SwappedBabyAI(level, told)
        for seed in range(1000, 1005):
            success, _ = follow_bot(env, seed)
            assert success
            assert env.reached[GOALS.index(told)]


def test_the_goal_that_is_not_told_is_noticed_as_well() -> None:
    """The way to one object is walked again while the other one is told."""
    own, other = SwappedBabyAI("GoToLocal", "original"), SwappedBabyAI("GoToLocal", "other")
    noticed = []
    for seed in range(1000, 1020):
        _, actions = follow_bot(own, seed)
        other.reset(seed=seed)
        ended = [other.step(action)[2] for action in actions]
        if not any(ended):
            noticed.append(other.reached)
    assert len(noticed) > 10
    assert set(noticed) == {(True, False)}


def test_lorel_starts_where_both_tasks_can_be_done() -> None:
    from lerobot_lisa.analysis.listening.swapped_lorel import SwappedLorel

    tasks = {task.instruction: task for task in SUITES["seen"]}
    close, others = tasks["close drawer"], [tasks["turn faucet left"], tasks["move white mug down"]]
    envs = {told: SwappedLorel(close, others, told) for told in GOALS}

    for seed, instruction in ((1000, "turn faucet left"), (1001, "move white mug down")):
        starts = {told: env.reset(seed=seed)[0]["agent_pos"] for told, env in envs.items()}
        assert np.array_equal(starts["original"], starts["other"])
        assert starts["original"][14] < -0.04  # the drawer is open
        assert envs["original"].task_description == "close drawer"
        assert envs["other"].task_description == instruction
    for env in envs.values():
        env.close()


# What is made of them.


def told_run(codes: list[int], actions: list[float], reached: list[tuple[bool, bool]]) -> ToldRun:
    episodes = range(len(codes))
    steps = pd.DataFrame({"group": "babyai", "task_id": 0, "episode": episodes, "step": 0, "code": codes})
    steps["observation"] = 5
    return ToldRun(steps.assign(action=[np.array([action], np.float32) for action in actions]), np.array(reached))


def test_swap_counts_on_known_answers() -> None:
    own = told_run([1, 1, 2, 3], [0, 1, 2, 2], [(True, False)] * 4)
    other = told_run([1, 2, 3, 4], [0, 1, 2, 3], [(False, True)] * 3 + [(True, False)])

    lines = list(swap.lines({"original": own, "other": other}))

    assert lines[0].split()[0] == "3/4"
    assert "62.5 %  of pairs" in lines[1]  # 1 - (1/4 + 1/16 + 1/16)
    assert lines[2].split()[0] == "1/4"
    assert lines[3].split()[0] == "1.0"
    assert [line.split()[0] for line in lines[4:]] == ["4/4", "0/4", "1/4", "3/4"]
    rows = swap.table({"original": own, "other": other})
    assert list(rows["successes"]) == [4, 0, 1, 3]


def test_the_common_way_ends_with_the_first_difference() -> None:
    def run(observations: list[int], actions: list[int]) -> pd.DataFrame:
        steps = pd.DataFrame({"group": "babyai", "task_id": 0, "episode": 0, "observation": observations})
        return steps.assign(step=range(len(steps)), action=[np.array([action], np.float32) for action in actions])

    way = run([1, 2, 3, 4], [0, 0, 1, 0])

    assert reactions.common_steps(way, way) == 4
    assert reactions.common_steps(way, run([1, 2, 3], [0, 0, 1])) == 3
    assert reactions.common_steps(way, run([1, 2, 3, 4], [0, 5, 1, 0])) == 1
    assert reactions.common_steps(way, run([1, 2, 9, 4], [0, 0, 1, 0])) == 2
    assert reactions.common_steps(way, run([9, 2, 3, 4], [0, 0, 1, 0])) == 0


def test_real_actions_are_measured_in_their_spread() -> None:
    own = told_run([0] * 3, [0.0, 0.5, 1.0], [(True, True)] * 3)
    other = told_run([0] * 3, [0.5, 1.0, 1.5], [(True, True)] * 3)

    line = list(swap.lines({"original": own, "other": other}))[2]

    assert "75.0 %" in line  # 0.5 against 2/3, the mean distance of two of them


def test_the_papers_instructions_about_the_drawer() -> None:
    said = instructions_about("close drawer")

    assert set(said[SAME]) == {"close drawer", "close container", "push drawer", "push container"}
    assert set(said[OTHER_VERB]) == {
        "rotate drawer", "rotate container", "move container down", "move drawer down", "open drawer",
        "open container", "pull drawer", "pull container",
    }  # fmt: skip
    assert set(said[OTHER_OBJECT]) == {"close mug", "close faucet", "push mug", "push faucet"}


def test_every_seen_task_has_its_words() -> None:
    assert set(MEANINGS) == {task.instruction for task in SUITES["seen"]}
    for task in MEANINGS:
        said = instructions_about(task)
        assert said[SAME][0] == task
        everything = [text for listed in said.values() for text in listed]
        assert len(set(everything)) == len(everything)


FACTS = {"policy": {"vocabulary": ["close", "drawer", "open"]}}


def test_affordance_on_known_answers() -> None:
    instructions = {SAME: ["close drawer", "push drawer"], OTHER_VERB: ["open drawer"]}
    codes = [[[7, 7], [7, 1], [2, 2]], [[7, 7], [7, 7], [7, 7]], [[1, 1], [1, 7], [1, 1]]]
    rows = [
        {"task_id": task, "episode": episode, "step": step, "instruction": text, "code": code}
        for task, text in enumerate(text for listed in instructions.values() for text in listed)
        for episode in range(3)
        for step, code in enumerate(codes[task][episode])
    ]
    episodes = [
        {"task_id": task, "episode": episode, "success": task == 1} for task in range(3) for episode in range(3)
    ]
    trace = Trace(pd.DataFrame(rows), pd.DataFrame(episodes), FACTS | {"instructions": instructions})

    found = affordance.table(trace, affordance.own_code(trace))

    assert affordance.own_code(trace) == 7
    assert list(found["first"]) == [2, 3, 0]
    assert list(found["ever"]) == [2, 3, 1]
    assert list(found["success"]) == [0, 3, 0]
    assert list(found["unknown"]) == ["", "push", ""]
    lines = list(affordance.lines(trace))
    assert lines[-2].split()[0] == "5/6"
    assert lines[-1].split()[0] == "0/3"
    drawn = affordance_plot(found, "7 drawer", affordance.READING, "3 starts")
    dots = [line for line in drawn.figure.axes[0].lines if str(line.get_label()).startswith("chosen first")]
    assert [line.get_xdata()[0] for line in dots] == pytest.approx([200 / 3, 100, 0])
    assert drawn.table is found


# The commands, on tiny policies in the real environments.


def diagnose(monkeypatch: pytest.MonkeyPatch, name: str, policy: Path, output: Path, *options: str) -> int:
    arguments = [name, f"--policy.path={policy}", f"--output_dir={output}", *options]
    monkeypatch.setattr("sys.argv", ["lisa-diagnose", *arguments])
    return main()


def test_swap_in_babyai(
    lisa: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["--env.type=babyai", "--env.task=GoToLocal", "--env.max_episode_steps=5", "--n_episodes=3"]

    assert diagnose(monkeypatch, "swap", lisa, tmp_path, *options, "--batch_size=2") == 0

    rows = pd.read_csv(tmp_path / "swap.csv")
    assert list(zip(rows["told"], rows["goal"], strict=True)) == [(told, goal) for told in GOALS for goal in GOALS]
    assert set(rows["episodes"]) == {3}
    printed = capsys.readouterr().out
    assert "first skill code changes" in printed
    assert swap.READING in printed
    assert diagnose(monkeypatch, "swap", lisa, tmp_path, *options, "--batch_size=2") == 0
    assert capsys.readouterr().out == printed  # from what was recorded


def test_swap_in_lorel(tabletop: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert diagnose(monkeypatch, "swap", tabletop, tmp_path, "--env.type=lorel", "--n_episodes=1") == 0

    assert set(pd.read_csv(tmp_path / "swap.csv")["episodes"]) == {6}


def test_affordance(
    tabletop: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["--env.type=lorel", "--env.task=close drawer", "--n_episodes=2"]

    assert diagnose(monkeypatch, "affordance", tabletop, tmp_path / "out", *options) == 0

    rows = pd.read_csv(tmp_path / "out" / "affordance.csv")
    assert len(rows) == 16
    assert rows["first"].iloc[0] >= 1
    assert (tmp_path / "out" / "affordance.png").read_bytes().startswith(b"\x89PNG")
    assert affordance.READING in capsys.readouterr().out


def test_rephrase(
    tabletop: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "log.txt").touch()  # as `lisa-reproduce` leaves one in the folder of every step

    assert diagnose(monkeypatch, "rephrase", tabletop, tmp_path / "out", "--env.type=lorel", "--n_episodes=1") == 0

    rows = pd.read_csv(tmp_path / "out" / "rephrase.csv").set_index("part")
    assert list(rows.index[:-1]) == list(KINDS)
    assert rows.loc["human", "episodes"] == 53
    assert rows.loc["seen", "same_code"] == 100
    assert "same code" in capsys.readouterr().out
    assert rephrase.READING


@pytest.mark.parametrize(
    ("name", "options", "said"),
    [
        ("affordance", ["--env.type=lorel", "--env.task=close door"], "choose one of: close drawer"),
        ("affordance", ["--env.type=babyai"], "the tasks of lorel"),
        ("rephrase", ["--env.type=babyai"], "the rephrasals are lorel's"),
        ("swap", ["--env.type=pusht"], "in babyai and lorel"),
        ("swap", ["--env.type=lorel", "--env.task=close drawer"], "name a suite"),
    ],
)
def test_mistakes_take_one_line(
    name: str,
    options: list[str],
    said: str,
    tabletop: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert diagnose(monkeypatch, name, tabletop, tmp_path / "out", *options, "--n_episodes=1") == 1

    printed = capsys.readouterr().err.strip().splitlines()[-1]
    assert printed.startswith("error: ")
    assert said in printed


def test_a_policy_without_codes_has_no_affordances(
    lang_dt: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["--env.type=lorel", "--env.task=close drawer"]

    assert diagnose(monkeypatch, "affordance", lang_dt, tmp_path, *options) == 1
    assert "only lisa policies have skill codes" in capsys.readouterr().err


@pytest.mark.parametrize("arguments", [[], ["swop"]])
def test_unknown_diagnoses_show_how(
    arguments: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["lisa-diagnose", *arguments])

    assert main() == 2
    assert "lisa-diagnose rephrase" in capsys.readouterr().err
