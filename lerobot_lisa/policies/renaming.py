"""Features that LeRobot has renamed for a policy (`--rename_map`): under which name the dataset has them."""

from collections.abc import Callable, Container, Mapping
from typing import Any

from lerobot.configs import PolicyFeature
from lerobot.utils.feature_utils import dataset_to_policy_features

from lerobot_lisa.errors import UserError


def renamed_features(
    wanted: Mapping[str, PolicyFeature],
    features: dict[str, dict[str, Any]],
    batch: Container[str],
    tell_apart: Callable[[str, list[str]], str | None] | None = None,
) -> dict[str, str]:
    """Match the policy's features that a dataset lacks with those of the dataset.

    LeRobot tells a policy nothing of the map, but a batch shows it: renamed features are in it under the policy's names
    and no longer under the dataset's.

    Args:
        wanted: The policy's observations.
        features: The dataset's, as in `info.json`.
        batch: Keys of a batch from the policy's preprocessor.
        tell_apart: Says which of several features of the dataset is one of the policy's; None: nobody can.

    Returns:
        The dataset's name to the policy's, for each feature whose names differ.

    Raises:
        UserError: A feature was not renamed but is missing, or several could be the one.
    """
    unused = {
        key: tuple(feature.shape)
        for key, feature in dataset_to_policy_features(features).items()
        if key.startswith("observation.") and key not in wanted and key not in batch
    }
    names: dict[str, str] = {}
    for key in [key for key in wanted if key not in features]:
        found = [name for name, shape in unused.items() if shape == tuple(wanted[key].shape)]
        if key not in batch or not found:
            raise UserError(f"the policy needs `{key}`, the dataset has {sorted(features)}: pass --rename_map")
        if len(found) > 1:
            chosen = tell_apart(key, found) if tell_apart else None
            found = [chosen] if chosen and chosen not in names else found
        if len(found) > 1:
            raise UserError(
                f"`{key}` may be any of the renamed {found}, which have the same shape: rename them in the dataset"
            )
        names[found[0]] = key
    return names
