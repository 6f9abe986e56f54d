"""Every folder of `lerobot_lisa/envs` is a family of environments that LeRobot knows once the package is imported."""

from pathlib import Path

import pytest
from lerobot.envs.configs import EnvConfig

import lerobot_lisa.envs

FAMILIES = sorted(path.parent.name for path in Path(lerobot_lisa.envs.__file__).parent.glob("*/config.py"))


def test_there_are_families() -> None:
    assert {"babyai", "lorel"} <= set(FAMILIES)


@pytest.mark.parametrize("family", FAMILIES)
def test_registered_and_built_alike(family: str) -> None:
    config = EnvConfig.get_choice_class(family)
    assert config.__module__ == f"lerobot_lisa.envs.{family}.config"
    (envs,) = (tasks[0] for tasks in config().create_envs(2).values())
    observations, info = envs.reset(seed=[0, 1])
    assert all(len(shown) == 2 for shown in observations.values())
    assert info["is_success"].tolist() == [False, False]
    assert all(envs.call("task_description"))
