"""A dataset that names actions without effect keeps them out of the loss, unless the user has said which."""

from typing import Any

import pytest
import tiny_datasets
from lerobot.configs import FeatureType, PolicyFeature
from tiny_policies import config

from lerobot_lisa.errors import UserError

MOVE = {"dtype": "float32", "shape": (5,), "names": ["x", "y", "z", "wrist", "gripper"], "info": {"ignored": ["wrist"]}}


def described(action: dict[str, Any], **settings: Any) -> list[int]:
    cfg = config(
        "lisa",
        input_features={"observation.state": PolicyFeature(FeatureType.STATE, (3,))},
        output_features={"action": PolicyFeature(FeatureType.ACTION, (5,))},
        **settings,
    )
    cfg.set_dataset_feature_metadata({"observation.state": tiny_datasets.STATE, "action": action})
    cfg.validate_features()
    return cfg.ignored_action_dimensions


def test_the_dataset_says_which_actions_are_ignored() -> None:
    assert described(MOVE) == [3]
    assert described({**MOVE, "info": {"ignored": ["gripper", "x"]}}) == [4, 0]


@pytest.mark.parametrize("info", [None, {}, {"ignored": []}, {"ignored": None}])
def test_without_a_word_about_it_none_is_ignored(info: dict[str, Any] | None) -> None:
    assert described({**MOVE, "info": info}) == []
    assert described({key: value for key, value in MOVE.items() if key != "info"}) == []


def test_what_the_user_has_set_stays() -> None:
    assert described(MOVE, ignored_action_dimensions=[0]) == [0]
    assert described(MOVE, ignored_action_dimensions=[]) == []


def test_an_ignored_action_without_a_name_is_refused() -> None:
    with pytest.raises(UserError, match=r"'elbow'.* is ignored, but its names are"):
        described({**MOVE, "info": {"ignored": ["elbow"]}})
    with pytest.raises(UserError, match="must leave at least one"):
        described({**MOVE, "info": {"ignored": MOVE["names"]}})
