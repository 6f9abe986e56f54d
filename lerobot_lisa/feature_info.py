"""Facts about features that must be the same where a policy is trained and where it acts: how images are drawn, say.

A dataset keeps them in the `info` of its features, LeRobot's place for them, and a policy in its configuration. An
environment sends its own along with every observation, in LeRobot's `info`.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

from lerobot_lisa.errors import UserError

KEY = "feature_info"
"""Where an environment's facts are in a batch's `info`."""

FeatureInfo = Mapping[str, Mapping[str, Any]]
"""Facts by feature and name, such as `{"observation.image": {"quality": "minimal"}}`."""


class Fact(NamedTuple):
    """A fact of an environment, and the option of the command line that changes it; empty if there is none."""

    value: Any
    option: str = ""


def feature_info(features: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """The facts that a dataset tells: the `info` of each of its features that has one."""
    return {key: dict(feature["info"]) for key, feature in features.items() if feature.get("info")}


def check_feature_info(trained: FeatureInfo, shown: Mapping[str, Mapping[str, Fact]]) -> None:
    """Compare what a policy was trained on with what an environment shows; what only one of them tells is left alone.

    Raises:
        UserError: They differ.
    """
    for key, facts in shown.items():
        for name, fact in facts.items():
            known = trained.get(key, {}).get(name, fact.value)
            if known != fact.value:
                fix = f"pass {fact.option}={known}" if fact.option else "train on data of this environment"
                raise UserError(
                    f"the policy was trained with {key} of {name} {known!r}, but the environment's is {fact.value!r}: "
                    f"{fix}, or --policy.feature_info=null to evaluate it all the same"
                )
