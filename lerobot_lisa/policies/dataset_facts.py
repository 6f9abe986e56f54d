"""What a dataset tells a policy beyond its features' types: symbols, number of actions, ignored dimensions, horizon."""

from typing import TYPE_CHECKING, Any

from lerobot.configs import FeatureType, PolicyFeature
from lerobot.utils.constants import ACTION, OBS_ENV_STATE

from lerobot_lisa.errors import UserError
from lerobot_lisa.feature_info import feature_info

if TYPE_CHECKING:
    from lerobot_lisa.policies.base_configuration import EpisodePolicyConfig

GRID_SYMBOLS = 16  # more than minigrid's 11 objects, 6 colours and 3 door states


def note_facts(
    config: "EpisodePolicyConfig", features: dict[str, dict[str, Any]], stats: dict[str, Any] | None, longest: int
) -> None:
    """Fill in what the user has not set; see `EpisodePolicyConfig.describe_dataset`."""
    for key, feature in (config.input_features or {}).items():
        if feature.type is FeatureType.STATE and _is_integer(features.get(key, {})):
            _check_symbols(key, stats)
            config.input_features[key] = PolicyFeature(FeatureType.ENV, feature.shape)  # out of reach of STATE scaling
        elif key == OBS_ENV_STATE and key in features and not _is_integer(features[key]):
            # LeRobot calls it ENV whatever it holds; as symbols, real numbers would be cut to integers.
            config.input_features[key] = PolicyFeature(FeatureType.STATE, feature.shape)
    if config.action_classes is None:
        config.action_classes = _count_classes(features.get(ACTION, {}), stats)
    _check_classes(config.action_classes, stats)
    if config.ignored_action_dimensions is None:
        config.ignored_action_dimensions = _ignored_dimensions(features.get(ACTION, {}))
    config.feature_info = feature_info(features)  # of the data it is trained on now, whatever came before
    if config.max_timesteps is None:
        config.max_timesteps = longest


def _is_integer(feature: dict[str, Any]) -> bool:
    return str(feature.get("dtype", "")).startswith(("int", "uint"))


def _check_symbols(key: str, stats: dict[str, Any] | None) -> None:
    low, high = _range(key, stats) or (0, 0)
    if low < 0 or high >= GRID_SYMBOLS:
        raise UserError(
            f"`{key}` holds integers from {low} to {high}, but symbols are 0..{GRID_SYMBOLS - 1}: "
            "store it as real numbers, or leave it out of --policy.input_features"
        )


def _check_classes(classes: int, stats: dict[str, Any] | None) -> None:
    low, high = _range(ACTION, stats) or (0, 0)
    if classes and (low < 0 or high >= classes):
        raise UserError(
            f"--policy.action_classes={classes} does not fit the dataset, whose actions are {low} to {high}: "
            f"pass {high + 1} or more, or 0 to treat them as real numbers"
        )


def _range(key: str, stats: dict[str, Any] | None) -> tuple[int, int] | None:
    """Least and greatest value of a feature, where the statistics tell."""
    known = (stats or {}).get(key, {})
    return (int(known["min"].min()), int(known["max"].max())) if {"min", "max"} <= known.keys() else None


def _ignored_dimensions(feature: dict[str, Any]) -> list[int]:
    """Dimensions that a dataset names as ignored by its environment."""
    ignored = (feature.get("info") or {}).get("ignored") or []
    names = list(feature.get("names") or [])
    unknown = [name for name in ignored if name not in names]
    if unknown:
        raise UserError(f"the dataset's action says that {unknown} is ignored, but its names are {names}: correct one")
    return [names.index(name) for name in ignored]


def _count_classes(feature: dict[str, Any], stats: dict[str, Any] | None) -> int:
    """Number of different actions; 0 for real-valued ones."""
    if not _is_integer(feature):
        return 0
    names = feature.get("names")
    if isinstance(names, dict) and names.get("classes"):
        return len(names["classes"])
    if stats and "max" in stats.get(ACTION, {}):
        return int(stats[ACTION]["max"].max()) + 1
    raise UserError("the dataset does not say how many different actions there are: pass --policy.action_classes=N")
