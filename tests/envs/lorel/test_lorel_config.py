"""LeRobot's own evaluation runs on the tabletop: suites as groups, equal in turn and in processes."""

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import draccus
import drawing
import numpy as np
import programs
import pytest
import torch
from lerobot.configs import FeatureType
from lerobot.envs.configs import EnvConfig
from lerobot.envs.factory import make_env_pre_post_processors
from lerobot.envs.utils import close_envs, env_to_policy_features
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.pretrained import PreTrainedPolicy
from lerobot.processor import PolicyProcessorPipeline
from lerobot.scripts.lerobot_eval import eval_policy_all, rollout

from dataset_converters.lorel.schema import lorel_layout
from lerobot_lisa.analysis.lorel_random_floor import main, random_outcomes
from lerobot_lisa.envs.lorel.config import LorelEnvConfig
from lerobot_lisa.envs.lorel.random_floor import random_floor, table
from lerobot_lisa.envs.lorel.suites import SUITES
from lerobot_lisa.errors import UserError
from lerobot_lisa.feature_info import KEY, check_feature_info, feature_info


class StatePolicy(PreTrainedPolicy):
    """Acts by a fixed function of the step and of whatever it is shown."""

    config_class = ACTConfig
    name = "state"

    def __init__(self) -> None:
        super().__init__(ACTConfig(device="cpu"))
        self.batches: list[dict[str, Any]] = []

    def reset(self) -> None:
        self.batches = []

    def select_action(self, batch: dict[str, Any]) -> torch.Tensor:
        self.batches.append(batch)
        shown = sum(v.flatten(1).sum(1) for k, v in sorted(batch.items()) if k.startswith("observation."))
        return torch.sin(shown[:, None] * torch.arange(1, 6) + len(self.batches))

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


@dataclass
class Command:
    env: EnvConfig


def test_options_from_the_command_line() -> None:
    options = ["--env.type=lorel", "--env.task=compositions", "--env.obs_type=pixels", "--env.image_quality=full"]
    config = draccus.parse(Command, args=options).env
    assert isinstance(config, LorelEnvConfig)
    assert (config.task, config.fps, config.type) == ("compositions", 80, "lorel")
    assert config.gym_kwargs == {"obs_type": "pixels", "image_quality": "full", "arm": "original", "render_size": 256}


@pytest.mark.parametrize(
    ("obs_type", "inputs"),
    [
        ("state", {"observation.state": (FeatureType.STATE, (15,))}),
        ("pixels", {"observation.image": (FeatureType.VISUAL, (3, 64, 64))}),
        (
            "pixels_state",
            {
                "observation.state": (FeatureType.STATE, (15,)),
                "observation.image": (FeatureType.VISUAL, (3, 64, 64)),
            },
        ),
    ],
)
def test_features(obs_type: str, inputs: dict[str, Any]) -> None:
    features = env_to_policy_features(LorelEnvConfig(obs_type=obs_type))
    assert {key: (feature.type, feature.shape) for key, feature in features.items()} == {
        "action": (FeatureType.ACTION, (5,)),
        **inputs,
    }


def test_groups_and_task_ids() -> None:
    envs = LorelEnvConfig(task="seen,compositions,pull the handle").create_envs(2)
    assert {group: list(tasks) for group, tasks in envs.items()} == {
        "seen": list(range(6)),
        "compositions": list(range(15)),
        "pull_the_handle": [0],
    }
    assert list(envs["seen"][2].call("task_description")) == ["turn faucet left"] * 2
    assert envs["compositions"][0].call("_max_episode_steps")[0] == 40
    assert all(
        sub.unwrapped._simulator is None for tasks in envs.values() for env in tasks.values() for sub in env.envs
    )


@pytest.mark.parametrize("obs_type", ["state", "pixels"])
def test_the_policy_is_told_what_it_is_shown(obs_type: str) -> None:
    config = LorelEnvConfig(obs_type=obs_type, image_quality="smooth", arm="free")
    before, _ = make_env_pre_post_processors(env_cfg=config, policy_cfg=ACTConfig(device="cpu"))
    batch = before({"observation.state": torch.zeros(2, 15), "task": ["go"] * 2})
    told = {key: {name: fact.value for name, fact in facts.items()} for key, facts in batch["info"][KEY].items()}
    quality = {"observation.image": {"quality": "smooth"}} if obs_type == "pixels" else {}
    assert told == {"observation.state": {"arm": "free"}, "action": {"ignored": ["wrist"]}, **quality}
    assert batch["task"] == ["go"] * 2
    layout = lorel_layout("me/d", "smooth", "free")
    check_feature_info(feature_info(layout.features), batch["info"][KEY])


def test_a_free_arm_says_that_it_compares_with_nobody(caplog: pytest.LogCaptureFixture) -> None:
    assert list(LorelEnvConfig(arm="free").create_envs(1)) == ["seen_free_arm"]
    assert "compare with nobody's" in caplog.text


def test_rollout_on_states() -> None:
    env = LorelEnvConfig(task="open drawer").create_envs(3)["open_drawer"][0]
    policy = StatePolicy()
    result = rollout(env, policy, seeds=[5, 6, 7], **processors())
    state = policy.batches[0]["observation.state"]
    assert (tuple(state.shape), state.dtype) == ((3, 15), torch.float32)
    assert policy.batches[0]["task"] == ["open drawer"] * 3
    assert result["action"].shape == (3, len(policy.batches), 5)
    assert len(policy.batches) <= 20


def test_rollout_on_pixels() -> None:
    drawing.needs_gl()
    env = LorelEnvConfig(task="open drawer", obs_type="pixels").create_envs(2)["open_drawer"][0]
    policy = StatePolicy()
    rollout(env, policy, seeds=[5, 6], **processors())
    image = policy.batches[0]["observation.image"]
    assert (tuple(image.shape), float(image.max()) <= 1) == ((2, 3, 64, 64), True)
    assert "observation.state" not in policy.batches[0]


@pytest.mark.slow
def test_processes_equal_turns(tmp_path) -> None:
    config = LorelEnvConfig(task="close drawer,shift black mug down", render_size=32)
    runs = []
    for use_async in (False, True):
        envs = config.create_envs(3, use_async)
        # lerobot-train evaluates the same environments again and again, and closes them each time.
        metrics = [
            [
                {"successes": task["metrics"]["successes"], "rewards": task["metrics"]["sum_rewards"]}
                for task in eval_policy_all(envs, StatePolicy(), n_episodes=5, start_seed=1000, **processors())[
                    "per_task"
                ]
            ]
            for _ in range(2)
        ]
        close_envs(envs)
        assert metrics[0] == metrics[1]
        runs.append(metrics[0])
    assert runs[0] == runs[1]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"task": "close draw"}, "no LOReL task 'close draw'"),
        ({"task": None}, "env.task is None: name a suite"),
        ({"max_parallel_tasks": 2}, "max_parallel_tasks is 2"),
        ({"obs_type": "touch"}, "obs_type is 'touch'"),
        ({"arm": "stiff"}, "no arm 'stiff'"),
        ({"render_size": 2}, "2 x 2 pixels"),
        ({"render_size": "big"}, "big x big pixels"),
    ],
)
def test_refusals(options: dict[str, Any], message: str) -> None:
    with pytest.raises(UserError, match=message):
        LorelEnvConfig(**options).create_envs(2)


@pytest.mark.parametrize("options", [{"task": "close draw"}, {"task": None}, {"max_parallel_tasks": 2}])
def test_names_are_looked_up_when_training_begins(options: dict[str, Any]) -> None:
    with pytest.raises(UserError):
        LorelEnvConfig(**options).get_env_processors()


@pytest.mark.slow
@pytest.mark.parametrize("package", ["mujoco", "metaworld"])
def test_importing_is_light_and_missing_packages_are_explained(package: str) -> None:
    code = f"""
import sys
from lerobot_lisa.envs.lorel import LorelEnvConfig
assert not {{"mujoco", "metaworld"}} & set(sys.modules)
sys.modules["{package}"] = None
LorelEnvConfig().create_envs(1)
"""
    run = programs.run("python", "-c", code)
    assert f'error: LOReL needs {package}: pip install "lerobot_policy_lisa[lorel]"' in run.stderr
    assert run.stdout == ""


def test_random_floor(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["random_floor", "--suite=seen", "--n_episodes=2"])
    assert main() == 0
    first = capsys.readouterr().out
    assert len(first.splitlines()) == 7
    assert "/12 " in first.splitlines()[-1]
    assert first.splitlines()[-1].endswith("all seen")
    main()
    assert capsys.readouterr().out == first


@pytest.mark.slow
def test_the_table_that_ships_is_what_is_measured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of two episodes for each task here; of 30 for each of the six, within 4 standard errors, below."""
    written = tmp_path / "floor.json"
    monkeypatch.setattr(sys, "argv", ["random_floor", f"--table={written}", "--n_episodes=2"])
    assert main() == 0
    measured = json.loads(written.read_text())
    assert measured.keys() == table().keys()
    assert {arm: list(keys) for arm, keys in measured["successes"].items()} == {
        arm: list(keys) for arm, keys in table()["successes"].items()
    }
    for number, task in enumerate(SUITES["seen"]):
        rate, n = random_floor(task) / 100, 30
        found = np.mean(random_outcomes(task, number, n, seed=500_000))
        assert abs(found - rate) < 4 * np.sqrt(rate * (1 - rate) / n)
