"""LeRobot's own evaluation runs on these environments: right metrics, equal in turn and in processes."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import draccus
import gymnasium as gym
import numpy as np
import programs
import pytest
import torch
from lerobot.configs import FeatureType
from lerobot.envs.configs import EnvConfig
from lerobot.envs.factory import make_env
from lerobot.envs.utils import close_envs, env_to_policy_features
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.pretrained import PreTrainedPolicy
from lerobot.processor import PolicyProcessorPipeline
from lerobot.scripts.lerobot_eval import eval_policy, eval_policy_all, rollout
from minigrid.utils.baby_ai_bot import BabyAIBot

from lerobot_lisa.envs.babyai.config import BabyAIEnvConfig
from lerobot_lisa.envs.babyai.env import BabyAIEnv
from lerobot_lisa.envs.vector import InTurn
from lerobot_lisa.errors import UserError


class RulePolicy(PreTrainedPolicy):
    """Acts by a rule of the step number and the batch, as float32 (B, 1)."""

    config_class = ACTConfig
    name = "rule"

    def __init__(self, rule: Callable[[int, dict[str, Any]], list[int]]) -> None:
        super().__init__(ACTConfig(device="cpu"))
        self.rule, self.step, self.batches = rule, 0, []

    def reset(self) -> None:
        self.step = 0

    def select_action(self, batch: dict[str, Any]) -> torch.Tensor:
        self.batches.append(batch)
        self.step += 1
        return torch.tensor(self.rule(self.step - 1, batch), dtype=torch.float32)[:, None]

    def get_optim_params(self) -> dict:
        return {}

    def forward(self, batch: dict[str, Any]) -> None:
        raise NotImplementedError

    def predict_action_chunk(self, batch: dict[str, Any]) -> torch.Tensor:
        raise NotImplementedError


def processors() -> dict[str, PolicyProcessorPipeline]:
    names = ("env_preprocessor", "env_postprocessor", "preprocessor", "postprocessor")
    identity = {"to_transition": lambda x: x, "to_output": lambda x: x}
    return {name: PolicyProcessorPipeline(steps=[], **identity) for name in names}


def by_observation(step: int, batch: dict[str, Any]) -> list[int]:
    """Depends on everything that the policy gets to see."""
    grid, direction = batch["observation.grid"], batch["observation.direction"]
    return [
        (int(g.sum() + d.sum()) + len(t) + step) % 6 for g, d, t in zip(grid, direction, batch["task"], strict=True)
    ]


def solved_by_bot(task: str, seeds: range) -> list[list[int]]:
    plans = []
    for seed in seeds:
        env, actions, ended = BabyAIEnv(task), [], False
        env.reset(seed=seed)
        bot, action = BabyAIBot(env._level), None
        while not ended:
            action = bot.replan(action)
            actions.append(int(action))
            ended = env.step(action)[2]
        plans.append(actions)
    return plans


@dataclass
class Command:
    env: EnvConfig


def test_options_from_the_command_line() -> None:
    options = ["--env.type=babyai", "--env.task=GoTo,BossLevel", "--env.max_episode_steps=30", "--env.tile_size=8"]
    config = draccus.parse(Command, args=options).env
    assert isinstance(config, BabyAIEnvConfig)
    assert config.gym_kwargs == {"max_episode_steps": 30, "tile_size": 8}
    assert (config.task, config.fps, config.type) == ("GoTo,BossLevel", 10, "babyai")


def test_features_are_not_state() -> None:
    features = env_to_policy_features(BabyAIEnvConfig())
    assert {key: (feature.type, feature.shape) for key, feature in features.items()} == {
        "observation.grid": (FeatureType.ENV, (147,)),
        "observation.direction": (FeatureType.ENV, (1,)),
        "action": (FeatureType.ACTION, (1,)),
    }


def test_batch_of_the_policy() -> None:
    envs = make_env(BabyAIEnvConfig(task="GoToLocal", max_episode_steps=2), n_envs=3)
    policy = RulePolicy(lambda step, batch: [6, 6, 6])
    rollout(envs["babyai"][0], policy, seeds=[5, 6, 7], **processors())
    batch = policy.batches[0]
    assert {k: (tuple(batch[k].shape), batch[k].dtype) for k in ("observation.grid", "observation.direction")} == {
        "observation.grid": ((3, 147), torch.float32),
        "observation.direction": ((3, 1), torch.float32),
    }
    twins = [BabyAIEnv("GoToLocal") for _ in range(3)]
    for i, twin in enumerate(twins):
        observation, _ = twin.reset(seed=5 + i)
        np.testing.assert_array_equal(batch["observation.grid"][i].numpy(), observation["grid"])
    assert batch["task"] == [twin.task_description for twin in twins]
    assert len(policy.batches) == 2


@pytest.mark.parametrize("task", ["GoToLocal", "PickupLoc"])
def test_lerobot_counts_what_succeeded(task: str, tmp_path) -> None:
    plans = solved_by_bot(task, range(1000, 1004))
    plans[1] = [6]  # gives up

    def follow(step: int, batch: dict[str, Any]) -> list[int]:
        return [plan[step] if step < len(plan) else 6 for plan in plans]

    env = BabyAIEnvConfig(task=task).create_envs(4)["babyai"][0]
    result = eval_policy(
        env,
        RulePolicy(follow),
        n_episodes=4,
        start_seed=1000,
        max_episodes_rendered=2,
        videos_dir=tmp_path,
        **processors(),
    )
    episodes = result["per_episode"]
    assert [episode["success"] for episode in episodes] == [True, False, True, True]
    rewards = [0 if i == 1 else 1 - 0.9 * len(plan) / 64 for i, plan in enumerate(plans)]
    assert [episode["sum_reward"] for episode in episodes] == pytest.approx(rewards)
    assert [path.stat().st_size > 0 for path in sorted(tmp_path.iterdir())] == [True, True]


class FailsThenSucceeds(gym.Env):
    """Fails in its first step; the episode after that would succeed in its first step. `length` postpones the end."""

    observation_space = gym.spaces.Dict({"grid": gym.spaces.Box(0, 1, (1,), np.uint8)})
    action_space = gym.spaces.Discrete(7)
    task = task_description = "trap"
    _max_episode_steps = 9

    def __init__(self, length: int) -> None:
        self.length, self.episode = length, 0

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.episode, self.steps = self.episode + 1, 0
        return {"grid": np.zeros(1, np.uint8)}, {"is_success": False}

    def step(self, action):
        self.steps += 1
        ended, success = self.steps >= self.length, self.episode > 1
        return {"grid": np.zeros(1, np.uint8)}, float(success), ended, False, {"is_success": ended and success}


def test_the_next_episode_never_counts() -> None:
    lengths = iter((1, 4))
    env = InTurn([lambda: FailsThenSucceeds(next(lengths))] * 2)
    env.reset(seed=[0, 1])  # LeRobot resets before each rollout; the first episode must still be the failing one
    for sub in env.envs:
        sub.unwrapped.episode = 0
    rule = RulePolicy(lambda step, batch: [0, 0])
    result = eval_policy(env, rule, n_episodes=2, start_seed=0, **processors())
    assert [(e["success"], e["sum_reward"]) for e in result["per_episode"]] == [(False, 0.0), (False, 0.0)]


def test_an_ended_episode_stays_as_it_ended() -> None:
    plans = solved_by_bot("GoToLocal", range(10, 12))
    first = int(np.argmin([len(plan) for plan in plans]))
    assert len(plans[first]) < len(plans[1 - first])
    env = BabyAIEnvConfig(task="GoToLocal").create_envs(2)["babyai"][0]
    env.reset(seed=[10, 11])
    for step in range(max(map(len, plans)) + 3):
        actions = [plan[step] if step < len(plan) else 0 for plan in plans]
        observation, rewards, _, _, info = env.step(np.array(actions, np.float32)[:, None])
        if step == len(plans[first]) - 1:
            last = observation["direction"][first].copy()
        elif step >= len(plans[first]):
            assert (rewards[first], info["is_success"][first]) == (0, True)
            np.testing.assert_array_equal(observation["direction"][first], last)


@pytest.mark.slow
def test_processes_equal_turns(capfd: pytest.CaptureFixture[str]) -> None:
    config = BabyAIEnvConfig(task="GoToLocal,PutNextLocal", max_episode_steps=20, tile_size=4)
    runs = []
    for use_async in (False, True):
        envs = config.create_envs(3, use_async)
        assert list(envs["babyai"]) == [0, 1]
        rolled = [
            rollout(env, RulePolicy(by_observation), seeds=[7, 8, 9], return_observations=True, **processors())
            for env in envs["babyai"].values()
        ]
        frames = [env.call("render") for env in envs["babyai"].values()]
        # lerobot-train evaluates the same environments again and again; LeRobot closes them after each time.
        metrics = []
        for _ in range(2):
            evaluated = eval_policy_all(envs, RulePolicy(by_observation), n_episodes=4, start_seed=1000, **processors())
            metrics.append([task["metrics"] for task in evaluated["per_task"]])
        assert metrics[0] == metrics[1]
        close_envs(envs)
        runs.append((rolled, metrics[0], frames))
    (turn, turn_metrics, turn_frames), (process, process_metrics, process_frames) = runs
    assert turn_metrics == process_metrics
    np.testing.assert_array_equal(turn_frames[0], process_frames[0])
    for one, other in zip(turn, process, strict=True):
        for key in ("action", "reward", "success", "done"):
            assert torch.equal(one[key], other[key])
        for key, value in one["observation"].items():
            assert key == "task" or torch.equal(value, other["observation"][key])
    assert capfd.readouterr().out == ""


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"task": "GoToLocl"}, "did you mean GoToLocal"),
        ({"task": "GoToLocal,Nope"}, "no BabyAI level 'Nope'"),
        ({"task": " , "}, "env.task is ' , ': name a BabyAI level"),
        ({"task": None}, "env.task is None: name a BabyAI level"),
        ({"max_parallel_tasks": 2}, "max_parallel_tasks is 2"),
        ({"tile_size": 7}, "tile_size is 7"),
        ({"max_episode_steps": 0}, "max_episode_steps is 0"),
    ],
)
@pytest.mark.parametrize("use_async", [False, True])
def test_refusals(options: dict[str, Any], message: str, use_async: bool) -> None:
    with pytest.raises(UserError, match=message):
        BabyAIEnvConfig(**options).create_envs(2, use_async)
    with pytest.raises(UserError, match=message):  # what training asks for when it begins
        BabyAIEnvConfig(**options).get_env_processors()


@pytest.mark.slow
def test_importing_is_light_and_missing_minigrid_is_explained() -> None:
    code = """
import sys
from lerobot_lisa.envs.babyai import BabyAIEnvConfig
assert not {"minigrid", "pygame"} & set(sys.modules)
sys.modules["minigrid"] = None
BabyAIEnvConfig().create_envs(1)
"""
    run = programs.run("python", "-c", code)
    assert "UserError" in run.stderr or run.stderr.startswith("error:"), run.stderr
    assert "pip install lerobot_policy_lisa[babyai]" in run.stderr
    assert run.stdout == ""
