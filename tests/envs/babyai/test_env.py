"""The environment keeps gymnasium's rules on every level and BabyAI's rules of success and time."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from minigrid.minigrid_env import MiniGridEnv
from minigrid.utils.baby_ai_bot import BabyAIBot

from lerobot_lisa.envs.babyai.env import BabyAIEnv
from lerobot_lisa.envs.babyai.levels import LEVELS, level_names
from lerobot_lisa.errors import UserError

FAMILIES = ("GoToLocal", "PutNextLocal", "PickupLoc", "Open", "Unlock", "PutNext", "GoToSeq", "BossLevel")


def solution(task: str, seed: int) -> list[int]:
    """Actions that solve the episode of a seed, by minigrid's bot on a level of its own."""
    env, actions = BabyAIEnv(task), []
    env.reset(seed=seed)
    bot, action, ended = BabyAIBot(env._level), None, False
    while not ended:
        action = bot.replan(action)
        actions.append(int(action))
        _, _, terminated, truncated, info = env.step(action)
        ended = terminated or truncated
    assert info["is_success"]
    return actions


@pytest.mark.filterwarnings("error", "ignore:.*alternative render modes")
@pytest.mark.parametrize("name", level_names())
def test_passes_gymnasiums_checker(name: str) -> None:
    check_env(BabyAIEnv(name, tile_size=2), skip_render_check=name not in LEVELS)


@pytest.mark.parametrize("name", FAMILIES)
def test_ten_thousand_random_steps(name: str) -> None:
    env, random = BabyAIEnv(name), np.random.default_rng(0)
    ended, resets = True, 0
    for action in random.integers(7, size=10_000):
        if ended:
            env.reset(seed=resets)
            assert env.task_description
            resets += 1
        observation, reward, terminated, truncated, info = env.step(np.array([action], np.float32))
        assert env.observation_space.contains(observation)
        assert info["is_success"] is (reward > 0)
        assert terminated or reward == 0
        ended = terminated or truncated
    assert resets > 1


@pytest.mark.parametrize("name", ["GoToLocal", "PutNext", "SynthSeq"])
def test_same_seed_same_episode(name: str) -> None:
    def trace(env: BabyAIEnv) -> list:
        observation, _ = env.reset(seed=1234)
        rows = [env.task_description, observation["grid"].tolist(), int(observation["direction"][0])]
        for action in np.random.default_rng(1).integers(7, size=60):
            observation, *rest = env.step(action)
            rows += [observation["grid"].tolist(), int(observation["direction"][0]), rest]
        return rows

    fresh, used = BabyAIEnv(name), BabyAIEnv(name)
    used.reset(seed=9)
    used.step(2)
    used.reset()
    assert trace(fresh) == trace(used)


def test_unseeded_resets_differ_but_follow_the_seed() -> None:
    one, other = BabyAIEnv("GoTo"), BabyAIEnv("GoTo")
    one.reset(seed=3)
    other.reset(seed=3)
    following = [(one.reset(), other.reset()) for _ in range(3)]
    assert all(np.array_equal(a[0]["grid"], b[0]["grid"]) for a, b in following)
    assert len({one.reset()[0]["grid"].tobytes() for _ in range(5)}) > 1


def test_observation_is_minigrids_flattened_in_c_order() -> None:
    env = BabyAIEnv("GoToLocal")
    observation, _ = env.reset(seed=0)
    stock = MiniGridEnv.gen_obs(env._level)
    np.testing.assert_array_equal(observation["grid"].reshape(7, 7, 3), stock["image"])
    assert observation["direction"].tolist() == [stock["direction"]]
    assert env.task_description == stock["mission"]


@pytest.mark.parametrize("name", ["GoToLocal", "PickupLoc", "PutNext", "BossLevel"])
def test_success_is_terminated_with_reward(name: str) -> None:
    actions = solution(name, seed=1)
    env = BabyAIEnv(name)
    _, info = env.reset(seed=1)
    assert info == {"is_success": False}
    for action in actions[:-1]:
        _, reward, terminated, truncated, info = env.step(action)
        assert (reward, terminated, truncated, info) == (0.0, False, False, {"is_success": False})
    _, reward, terminated, truncated, info = env.step(actions[-1])
    assert (terminated, truncated, info) == (True, False, {"is_success": True})
    assert 0 < reward <= 1


def test_success_on_the_last_permitted_step_counts() -> None:
    actions = solution("GoToLocal", seed=1)
    env = BabyAIEnv("GoToLocal", max_episode_steps=len(actions))
    env.reset(seed=1)
    *_, (_, reward, terminated, truncated, info) = [env.step(action) for action in actions]
    assert (terminated, truncated, info["is_success"]) == (True, True, True)
    assert reward == pytest.approx(0.1)

    late = BabyAIEnv("GoToLocal", max_episode_steps=len(actions) - 1)
    late.reset(seed=1)
    *_, (_, reward, terminated, truncated, info) = [late.step(action) for action in actions[:-1]]
    assert (reward, terminated, truncated, info["is_success"]) == (0.0, False, True, False)


def test_failure_is_terminated_without_success() -> None:
    env = BabyAIEnv("OpenDoorDebug")  # strict: opening a wrong door ends the episode
    level = env._level
    for seed in range(50):
        env.reset(seed=seed)
        wrong = next((d for d in level.room_grid[1][1].doors if d and d not in level.instrs.desc.obj_set), None)
        if wrong is not None:
            break
    x, y = wrong.cur_pos
    dx, dy = next(d for d in ((1, 0), (0, 1), (-1, 0), (0, -1)) if level.grid.get(x - d[0], y - d[1]) is None)
    level.agent_pos = (x - dx, y - dy)
    level.agent_dir = [(1, 0), (0, 1), (-1, 0), (0, -1)].index((dx, dy))
    _, reward, terminated, _, info = env.step(5)
    assert (reward, terminated, info["is_success"]) == (0.0, True, False)


@pytest.mark.parametrize(("name", "limit"), [("GoToLocal", 64), ("GoTo", 576), ("PutNextLocal", 128)])
def test_babyais_own_limit_truncates(name: str, limit: int) -> None:
    env = BabyAIEnv(name)
    env.reset(seed=0)
    ends = [env.step(6)[2:4] for _ in range(limit)]
    assert ends == [(False, False)] * (limit - 1) + [(False, True)]
    assert env._max_episode_steps >= limit


def test_limit_follows_the_episode_and_stays_below_the_bound() -> None:
    env = BabyAIEnv("BossLevel")
    limits = set()
    for seed in range(30):
        env.reset(seed=seed)
        limits.add(env._level.max_steps)
    assert len(limits) > 2
    assert max(limits) <= env._max_episode_steps == 4608


def test_fixed_limit() -> None:
    env = BabyAIEnv("GoToSeq", max_episode_steps=7)
    assert env._max_episode_steps == 7
    for seed in range(3):
        env.reset(seed=seed)
        assert [env.step(6)[3] for _ in range(7)] == [False] * 6 + [True]


@pytest.mark.parametrize("action", [2, np.int64(2), np.array([2.0], np.float32), np.array([1.6], np.float32), [2.4]])
def test_takes_what_lerobot_sends(action) -> None:
    env, twin = BabyAIEnv("GoToLocal"), BabyAIEnv("GoToLocal")
    env.reset(seed=4)
    twin.reset(seed=4)
    env.step(action)
    twin.step(2)
    assert env._level.hash() == twin._level.hash()
    assert env._level.step_count == 1


@pytest.mark.parametrize(
    "action", [7, -1, np.array([6.6], np.float32), float("nan"), float("inf"), [1, 2], np.zeros((7,), np.float32)]
)
def test_refuses_other_actions(action) -> None:
    env = BabyAIEnv("GoToLocal")
    env.reset(seed=0)
    with pytest.raises(ValueError, match="one number from 0 to 6"):
        env.step(action)
    assert env._level.step_count == 0


def test_step_and_render_before_reset_and_after_close() -> None:
    env = BabyAIEnv("GoToLocal")
    for _ in range(2):
        with pytest.raises(gym.error.ResetNeeded, match="call reset before step"):
            env.step(2)
        with pytest.raises(gym.error.ResetNeeded, match="call reset before render"):
            env.render()
        env.reset(seed=0)
        env.step(2)
        env.close()


def test_names_and_refusals() -> None:
    assert BabyAIEnv("BabyAI-GoToLocal-v0").task == "GoToLocal"
    with pytest.raises(UserError, match="did you mean GoToLocal"):
        BabyAIEnv("GoToLocl")
    for steps in (0, 2.0, "9"):
        with pytest.raises(UserError, match=f"max_episode_steps is {steps!r}: give a whole number from 1 up"):
            BabyAIEnv("GoToLocal", max_episode_steps=steps)
    for size in (7, "8"):
        with pytest.raises(UserError, match=f"tile_size is {size!r}: choose an even number"):
            BabyAIEnv("GoToLocal", tile_size=size)


def test_nothing_is_printed(capfd: pytest.CaptureFixture[str]) -> None:
    env = BabyAIEnv("GoToSeq")
    for seed in range(10):
        env.reset(seed=seed)
    env.render()
    assert capfd.readouterr() == ("", "")
