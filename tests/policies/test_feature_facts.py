"""A policy remembers what its dataset tells about the features, and refuses a world that tells something else."""

from pathlib import Path
from typing import Any

import pytest
import tiny_datasets
import torch
from lerobot.policies.factory import get_policy_class
from tiny_policies import Training, training

from lerobot_lisa.errors import UserError
from lerobot_lisa.feature_info import KEY, Fact

STATE = {**tiny_datasets.STATE, "info": {"arm": "original"}}
MOVE = {**tiny_datasets.MOVE, "info": {"ignored": ["dy"]}}
TOLD = {"observation.state": {"arm": "original"}, "action": {"ignored": ["dy"]}}


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tiny_datasets.write(tmp_path_factory.mktemp("facts") / "data", {"observation.state": STATE, "action": MOVE})


def act(made: Training, **batch: Any) -> torch.Tensor:
    made.policy.reset()
    return made.policy.select_action(made.preprocessor({"task": ["go"] * 2, **batch}))


@pytest.mark.parametrize("kind", ["lisa", "lang_dt"])
def test_facts_come_from_the_dataset_and_go_into_the_checkpoint(kind: str, data: Path, tmp_path: Path) -> None:
    made = training(kind, data)
    assert made.policy.config.feature_info == TOLD
    made.policy.save_pretrained(tmp_path)
    assert get_policy_class(kind).from_pretrained(tmp_path).config.feature_info == TOLD
    assert training(kind, data, feature_info={"action": {}}).policy.config.feature_info == TOLD  # fine-tuned


def test_another_world_is_refused(data: Path) -> None:
    made, state = training("lang_dt", data), torch.zeros(2, 3)
    same = {KEY: {"observation.state": {"arm": Fact("original", "--env.arm")}}}
    other = {KEY: {"observation.state": {"arm": Fact("free", "--env.arm")}}}
    for info in ({}, same):
        assert act(made, **{"observation.state": state, "info": info}).shape == (2, 2)
    with pytest.raises(UserError, match=r"of arm 'original', but .* is 'free': pass --env\.arm=original, or"):
        act(made, **{"observation.state": state, "info": other})
    made.policy.config.feature_info = None
    assert act(made, **{"observation.state": state, "info": other}).shape == (2, 2)


def test_a_world_that_does_not_show_what_was_learned_from(data: Path) -> None:
    with pytest.raises(UserError, match=r"trained on observation\.state, but the environment shows observation\.image"):
        act(training("lang_dt", data), **{"observation.image": torch.zeros(2, 3, 8, 8)})
