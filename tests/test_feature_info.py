"""What a policy was trained on is compared with what it is shown; a difference is one line with its fix."""

import pytest

from lerobot_lisa.errors import UserError
from lerobot_lisa.feature_info import Fact, check_feature_info, feature_info

SHOWN = {"observation.image": {"quality": Fact("minimal", "--env.image_quality")}, "action": {"ignored": Fact(["w"])}}


def test_facts_of_a_dataset() -> None:
    features = {
        "observation.image": {"dtype": "image", "info": {"quality": "full"}},
        "observation.state": {"dtype": "float32", "info": None},
        "action": {"dtype": "float32"},
    }
    assert feature_info(features) == {"observation.image": {"quality": "full"}}


@pytest.mark.parametrize(
    "trained",
    [
        {},
        {"observation.image": {"quality": "minimal", "fps": 3}, "action": {"ignored": ["w"]}},
        {"observation.state": {"arm": "free"}},
    ],
)
def test_equal_and_unknown_facts(trained: dict) -> None:
    check_feature_info(trained, SHOWN)


def test_differences() -> None:
    with pytest.raises(UserError) as image:
        check_feature_info({"observation.image": {"quality": "full"}}, SHOWN)
    assert str(image.value) == (
        "the policy was trained with observation.image of quality 'full', but the environment's is 'minimal': "
        "pass --env.image_quality=full, or --policy.feature_info=null to evaluate it all the same"
    )
    with pytest.raises(UserError, match=r"action of ignored \[\], .* is \['w'\]: train on data of this environment"):
        check_feature_info({"action": {"ignored": []}}, SHOWN)
