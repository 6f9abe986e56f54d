"""The environment keeps gymnasium's rules and LOReL's rules of success and time."""

import drawing
import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from lerobot_lisa.envs.lorel.env import LorelEnv
from lerobot_lisa.envs.lorel.state import ACTION_NAMES, STATE_NAMES
from lerobot_lisa.errors import UserError

CLOSING = np.array([1, 1, -1, 0, 0], np.float32)


@pytest.mark.filterwarnings("ignore:.*(infinity|symmetric and normalized|alternative render modes).*")
@pytest.mark.parametrize("obs_type", ["state", "pixels", "pixels_state"])
def test_passes_gymnasiums_checker(obs_type: str) -> None:
    drawing.needs_gl()
    env = LorelEnv(obs_type=obs_type, render_size=32)
    check_env(env)
    env.close()


def episode(env: LorelEnv, seed: int) -> list:
    """Everything that an episode of fixed random actions shows."""
    actions = np.random.default_rng(seed).uniform(-1, 1, (40, 5)).astype(np.float32)
    observation, info = env.reset(seed=seed)
    rows, ended = [(observation["agent_pos"].tobytes(), info)], False
    for action in actions:
        if ended:
            break
        observation, *rest = env.step(action)
        rows.append((observation["agent_pos"].tobytes(), rest))
        ended = rest[1] or rest[2]
    return rows


def test_same_seed_same_episode() -> None:
    fresh, used = LorelEnv("turn faucet left"), LorelEnv("turn faucet left")
    episode(used, 8)
    used.close()
    assert episode(fresh, 1000) == episode(used, 1000) != episode(used, 1001)


def test_unseeded_resets_follow_the_seed() -> None:
    one, other = LorelEnv(), LorelEnv()
    one.reset(seed=3)
    other.reset(seed=3)
    states = [(env.reset()[0]["agent_pos"], env.reset()[0]["agent_pos"]) for env in (one, other)]
    np.testing.assert_array_equal(states[0], states[1])
    assert not np.array_equal(*states[0])


@pytest.mark.parametrize(("task", "steps"), [("open drawer", 20), ("shift white mug right", 40)])
def test_time_runs_out(task: str, steps: int) -> None:
    env = LorelEnv(task)
    env.reset(seed=1)
    ends = [env.step(np.zeros(5))[1:] for _ in range(steps)]
    assert ends == [(0.0, False, False, {"is_success": False})] * (steps - 1) + [
        (0.0, False, True, {"is_success": False})
    ]
    assert env._max_episode_steps == steps


def test_success_ends_the_episode_with_reward() -> None:
    env, outcomes = LorelEnv("close drawer"), []
    for seed in range(30):
        rows = episode(env, seed)
        outcomes.append(rows[-1][1][3]["is_success"])
        reward, terminated, truncated, info = rows[-1][1]
        assert (reward, terminated, info["is_success"]) in ((1.0, True, True), (0.0, False, False))
        assert truncated is (len(rows) == 21)
        first, last = (np.frombuffer(row[0], np.float32)[14] for row in (rows[0], rows[-1]))
        assert info["is_success"] == (last - first > 0.02)
    assert any(outcomes)
    assert not all(outcomes)


def test_observations_and_names() -> None:
    drawing.needs_gl()
    env = LorelEnv(obs_type="pixels_state", render_size=48)
    observation, _ = env.reset(seed=0)
    assert {key: (value.shape, value.dtype) for key, value in observation.items()} == {
        "agent_pos": ((15,), np.float32),
        "pixels": ((64, 64, 3), np.uint8),
    }
    assert env.render().shape == (48, 48, 3)
    assert len(STATE_NAMES) == 15
    assert ACTION_NAMES[3] == "wrist"
    assert env.action_space.high[3] == np.float32(np.pi)


def test_the_first_picture_shows_the_first_state() -> None:
    drawing.needs_gl()
    both, state = LorelEnv(obs_type="pixels_state"), LorelEnv()
    one, _ = both.reset(seed=4)
    state.reset(seed=4)
    still = np.zeros(5, np.float32)
    moved, *_ = both.step(still)
    assert np.array_equal(one["agent_pos"], state.reset(seed=4)[0]["agent_pos"])
    # Everything has settled: doing nothing for a step changes next to nothing.
    assert np.abs(one["pixels"].astype(int) - moved["pixels"]).mean() < 4
    assert one["pixels"].std() > 10


def test_step_and_render_before_reset_and_after_close() -> None:
    env = LorelEnv()
    for _ in range(2):
        with pytest.raises(gym.error.ResetNeeded, match="call reset before step"):
            env.step(CLOSING)
        with pytest.raises(gym.error.ResetNeeded, match="call reset before render"):
            env.render()
        env.reset(seed=0)
        env.step(CLOSING)
        env.close()


def test_refusals() -> None:
    for options, message in (
        ({"task": "dance"}, "no LOReL task 'dance'"),
        ({"obs_type": "touch"}, "env.obs_type is 'touch'"),
        ({"image_quality": "best"}, "no image quality 'best'"),
        ({"arm": "stiff"}, "no arm 'stiff'"),
        ({"render_size": 5000}, "5000 x 5000"),
    ):
        with pytest.raises(UserError, match=message):
            LorelEnv(**options)
