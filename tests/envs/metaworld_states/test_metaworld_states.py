"""Meta-World without pictures: the same world as LeRobot's, in which nothing is drawn."""

from importlib.util import find_spec
from typing import Any

import numpy as np
import pytest

if find_spec("mujoco") is None or find_spec("metaworld") is None:
    pytest.skip("Meta-World is not installed", allow_module_level=True)

from lerobot.envs.configs import MetaworldEnv as MetaworldConfig
from lerobot.envs.utils import env_to_policy_features

from dataset_converters.metaworld.expert import MetaworldEpisode, demonstrate, world
from lerobot_lisa.envs.engine import check_drawing
from lerobot_lisa.envs.metaworld_states.config import MetaworldStatesConfig
from lerobot_lisa.envs.metaworld_states.env import MetaworldStatesEnv
from lerobot_lisa.errors import UserError

TASK, SEED = "stick-push-v3", 1000


@pytest.fixture(scope="module")
def shown() -> MetaworldEpisode:
    """What the expert does; the collector's test holds it against what LeRobot's environment shows."""
    episode = demonstrate(MetaworldStatesEnv(TASK), SEED)
    assert episode is not None
    return episode


def test_the_same_starts_steps_and_success_and_nothing_is_drawn(
    shown: MetaworldEpisode, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As LeRobot evaluates: environments side by side, of which one ends first and another never does."""
    from gymnasium.envs.mujoco.mujoco_rendering import MujocoRenderer

    def draw(*given: Any, **named: Any) -> None:
        raise AssertionError("a picture was drawn")

    monkeypatch.setattr(MujocoRenderer, "render", draw)
    length = len(shown.action)
    (env,) = MetaworldStatesConfig(task=TASK, max_episode_steps=length).create_envs(2)[TASK].values()
    observation, _ = env.reset(seed=[SEED, SEED + 1])
    for t, (state, action) in enumerate(zip(shown.state, shown.action, strict=True)):
        assert observation.keys() == {"agent_pos"}
        assert np.array_equal(observation["agent_pos"][0].astype(np.float32), state)
        observation, _, ended, _, info = env.step(np.stack([action, np.zeros(4, np.float32)]))
        assert ended.tolist() == info["is_success"].tolist() == [t == length - 1, False]
    assert env.call("task_description") == ("Grasp a stick and push a box using the stick",) * 2
    assert env.call("_max_episode_steps") == (length, length)
    env.close()


def test_black_videos_cost_nothing() -> None:
    """`lerobot-eval` draws each step of ten episodes of a task, and has no option against it."""
    (env,) = MetaworldStatesConfig(task=TASK, videos=False).create_envs(1)[TASK].values()
    env.reset(seed=[SEED])
    (picture,) = env.call("render")
    assert picture.shape == (64, 64, 3)
    assert not picture.any()
    assert env.envs[0].unwrapped._env.mujoco_renderer._viewers == {}
    env.close()


@pytest.mark.slow
def test_states_are_those_that_lerobots_environment_shows() -> None:
    try:
        check_drawing("Meta-World", "--states-only")
    except UserError as error:
        pytest.skip(str(error))
    ours = MetaworldStatesEnv(TASK)
    with world(TASK) as theirs:
        pairs = [(ours.reset(seed=SEED), theirs.reset(seed=SEED))]
        for action in np.random.default_rng(0).uniform(-1, 1, (5, 4)).astype(np.float32):
            pairs.append((ours.step(action), theirs.step(action)))
    for (own, *_), (other, *_) in pairs:
        assert np.array_equal(own["agent_pos"], other["agent_pos"])
        assert own["agent_pos"].dtype == other["agent_pos"].dtype


def test_policies_are_told_the_same_features_but_for_the_picture() -> None:
    theirs = env_to_policy_features(MetaworldConfig())
    del theirs["observation.image"]
    assert env_to_policy_features(MetaworldStatesConfig()) == theirs
    assert MetaworldStatesConfig().fps == MetaworldConfig().fps


def test_benchmarks_are_groups_of_tasks() -> None:
    envs = MetaworldStatesConfig(task="MT10, reach-v3").create_envs(1)
    assert {group: len(tasks) for group, tasks in envs.items()} == {"MT10": 10, "reach-v3": 1}
    assert [env.call("task")[0] for env in envs["MT10"].values()][:2] == ["reach-v3", "push-v3"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"task": "reach-v2"}, "'reach-v2' is no task of Meta-World: did you mean reach-v3"),
        ({"task": " , "}, "env.task is ' , ': name MT10, or tasks such as reach-v3"),
        ({"max_episode_steps": 501}, "env.max_episode_steps is 501: give a whole number from 1 to 500"),
        ({"max_parallel_tasks": 2}, "env.max_parallel_tasks is 2"),
    ],
)
def test_bad_options_are_one_line_when_training_begins(options: dict[str, Any], message: str) -> None:
    config = MetaworldStatesConfig(**options)
    for begin in (config.get_env_processors, lambda: config.create_envs(1)):
        with pytest.raises(UserError) as refused:
            begin()
        assert message in str(refused.value)
