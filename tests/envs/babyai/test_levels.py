"""Levels by name: the same worlds as minigrid's environments, quiet, and a helpful error for a wrong name."""

import contextlib
import io

import gymnasium as gym
import pytest
from minigrid.utils.baby_ai_bot import BabyAIBot

from lerobot_lisa.envs.babyai.levels import LEVELS, check_level, level_names, make_level, max_steps_bound
from lerobot_lisa.errors import UserError


def test_names_cover_the_paper_and_all_of_minigrid() -> None:
    registered = {name for name in gym.registry if name.startswith("BabyAI-")}
    assert len(set(LEVELS)) == 19
    assert level_names()[:19] == LEVELS
    assert {check_level(name) for name in registered} == set(level_names()) - {"PutNext"}
    assert len(level_names()) == len(registered) + 1


@pytest.mark.parametrize("name", sorted(set(level_names()) - {"PutNext"}))
def test_equals_the_registered_environment(name: str) -> None:
    level = make_level(name)
    (identity,) = [i for i in gym.registry if i.startswith(f"BabyAI-{name}-v")]
    twin = gym.make(identity).unwrapped
    for seed in (1, 2):
        ours = level.reset(seed=seed)[0]
        with contextlib.redirect_stdout(io.StringIO()):
            theirs = twin.reset(seed=seed)[0]
        assert (ours["mission"], ours["direction"]) == (theirs["mission"], theirs["direction"])
        assert (level.hash(), level.max_steps) == (twin.hash(), twin.max_steps)
        for action in (2, 0, 2, 3, 1, 2, 5, 4):
            assert level.step(action)[1:] == twin.step(action)[1:]


@pytest.mark.parametrize("name", level_names())
def test_step_limit_is_bounded(name: str) -> None:
    level = make_level(name)
    for seed in range(5):
        level.reset(seed=seed)
        assert 0 < level.max_steps <= max_steps_bound(level)


def test_longest_instructions_meet_the_bound() -> None:
    for name, longest in (("GoToSeq", 2304), ("BossLevel", 4608), ("PutNextLocal", 128)):
        assert max_steps_bound(make_level(name)) == longest


@pytest.mark.parametrize("name", ["GoToLocal", "PutNext", "PutNextS5N2Carrying", "SynthSeq"])
def test_same_seed_same_episode_whatever_came_before(name: str) -> None:
    one, other = make_level(name), make_level(name)
    other.reset(seed=77)
    other.step(2)
    assert one.reset(seed=5)[0]["mission"] == other.reset(seed=5)[0]["mission"]
    assert one.hash() == other.hash()


def test_putnext_is_solved_by_minigrids_bot() -> None:
    level = make_level("PutNext")
    for seed in range(5):
        mission = level.reset(seed=seed)[0]["mission"]
        assert mission.startswith("put ")
        assert " next to " in mission
        assert level.max_steps == 2 * 64 * 9
        bot, action, terminated, reward = BabyAIBot(level), None, False, 0.0
        while not terminated:
            action = bot.replan(action)
            _, reward, terminated, truncated, _ = level.step(action)
            assert not truncated
        assert reward > 0


def test_first_observation_shows_an_object_carried_from_the_start() -> None:
    level = make_level("PutNextS5N2Carrying")
    observation, _ = level.reset(seed=0)
    assert observation["image"][3, 6].tolist() == list(level.carrying.encode())


def test_rejected_worlds_are_not_printed(capfd: pytest.CaptureFixture[str]) -> None:
    level = make_level("GoToSeq")
    for seed in range(20):
        level.reset(seed=seed)
    assert capfd.readouterr().out == ""
    with contextlib.redirect_stdout(io.StringIO()) as stock:
        twin = gym.make("BabyAI-GoToSeq-v0")
        for seed in range(20):
            twin.reset(seed=seed)
    assert "Sampling rejected" in stock.getvalue(), "these seeds must meet rejections for the test to mean anything"


@pytest.mark.parametrize(
    ("wrong", "hint"), [("gotolocal", "GoToLocal"), ("BossLevl", "BossLevel"), ("BabyAI-Pikup-v0", "Pickup")]
)
def test_unknown_level_lists_close_matches(wrong: str, hint: str) -> None:
    with pytest.raises(UserError, match=f"no BabyAI level '{wrong}': did you mean {hint}.*level_names") as error:
        make_level(wrong)
    assert "\n" not in str(error.value)


def test_unknown_level_without_close_match() -> None:
    with pytest.raises(UserError, match="no BabyAI level 'zzz': All 97 names"):
        make_level("zzz")
