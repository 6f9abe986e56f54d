"""What a dataset's features and statistics tell about a policy: which of them are symbols, which actions classes."""

import logging
import math
from collections.abc import Mapping
from typing import Any

from lerobot.configs import FeatureType, NormalizationMode, PolicyFeature
from lerobot.utils.constants import ACTION, OBS_ENV_STATE

from lerobot_lisa.errors import UserError
from lerobot_lisa.feature_info import feature_info
from lerobot_lisa.policies.episode_settings import SYMBOLS, EpisodeSettings

Described = Mapping[str, dict[str, Any]]  # features of an `info.json`
Stats = dict[str, dict[str, Any]] | None


def learn_features(config: EpisodeSettings, features: dict[str, dict[str, Any]]) -> None:
    """Take from a dataset's `info.json` what its `PolicyFeature`s do not say. What the user has set stays.

    Integer and boolean observations become symbols unless they are `numbers`, an integer action becomes categorical.

    Raises:
        UserError: An ignored action has no name.
    """
    _tell_symbols_from_numbers(config, features)
    action = features.get(ACTION, {})
    if action.get("dtype") == "bool":  # switches, which have no mean to be taken off
        config.normalization_mapping.setdefault("ACTION", NormalizationMode.IDENTITY)
    if config.action_classes is None:
        config.action_classes = _count_classes(action)
    if config.ignored_action_dimensions is None:
        config.ignored_action_dimensions = _ignored_dimensions(action)
    config.feature_info = feature_info(features)  # of the data it is trained on now, whatever came before


def learn_statistics(config: EpisodeSettings, stats: Stats, longest: int) -> None:
    """Take from a dataset what only its contents tell; comes after `learn_features`.

    Args:
        config: Is changed.
        stats: The dataset's statistics; they tell how many actions there are where `info.json` does not.
        longest: Frames in its longest episode, how far rollouts will look back.

    Raises:
        UserError: A feature holds more symbols or actions than there is room for.
    """
    for key, feature in (config.input_features or {}).items():
        if feature.type is FeatureType.ENV:
            _make_sure_of_symbols(config, key, stats)
    _learn_actions(config, stats)
    if config.max_timesteps is None:
        config.max_timesteps = longest


def _tell_symbols_from_numbers(config: EpisodeSettings, features: Described) -> None:
    for key, feature in (config.input_features or {}).items():
        described = features.get(key, {})
        whole = _is_integer(described) or described.get("dtype") == "bool"
        if feature.type is FeatureType.STATE and whole and key not in (config.numbers or []):
            # Out of reach of STATE scaling.
            config.input_features[key] = PolicyFeature(FeatureType.ENV, feature.shape)
        elif key == OBS_ENV_STATE and key in features and not _is_integer(features[key]):
            # LeRobot calls it ENV whatever it holds; as symbols, real numbers would be cut to integers.
            config.input_features[key] = PolicyFeature(FeatureType.STATE, feature.shape)


def _make_sure_of_symbols(config: EpisodeSettings, key: str, stats: Stats) -> None:
    """Integers that are too many for symbols are numbers, unless the user has said which are."""
    low, high = _range(key, stats)
    if low >= 0 and high < SYMBOLS:
        return
    if config.numbers is not None:
        raise UserError(
            f"`{key}` holds integers from {low:g} to {high:g}, but symbols are 0..{SYMBOLS - 1}: "
            "name it in --policy.numbers, or leave it out of --policy.input_features"
        )
    logging.warning("`%s` holds integers from %g to %g: numbers, no symbols", key, low, high)
    config.input_features[key] = PolicyFeature(FeatureType.STATE, config.input_features[key].shape)


def _learn_actions(config: EpisodeSettings, stats: Stats) -> None:
    low, high = _range(ACTION, stats)
    if config.action_classes is None:
        if "max" not in (stats or {}).get(ACTION, {}):
            raise UserError(
                "the dataset does not say how many different actions there are: pass --policy.action_classes=N"
            )
        config.action_classes = int(high) + 1
    if config.action_classes and (low < 0 or high >= config.action_classes):
        fix = "number them from 0" if low < 0 else f"pass {high + 1:g} or more"
        raise UserError(
            f"--policy.action_classes={config.action_classes} does not fit the dataset, whose actions are {low:g} to "
            f"{high:g}: {fix}, or pass 0 to treat them as real numbers"
        )


def _is_integer(feature: dict[str, Any]) -> bool:
    return str(feature.get("dtype", "")).startswith(("int", "uint"))


def _count_classes(action: dict[str, Any]) -> int | None:
    """Number of different actions as `info.json` tells it: 0 for real-valued ones, None if it does not."""
    if action.get("dtype") == "bool":
        return 2 if math.prod(action["shape"]) == 1 else 0
    if not _is_integer(action) or math.prod(action["shape"]) != 1:
        return 0
    names = action.get("names")
    return len(names["classes"]) if isinstance(names, dict) and names.get("classes") else None


def _ignored_dimensions(action: dict[str, Any]) -> list[int]:
    """Dimensions that a dataset names as ignored by its environment."""
    ignored = (action.get("info") or {}).get("ignored") or []
    names = list(action.get("names") or [])
    unknown = [name for name in ignored if name not in names]
    if unknown:
        raise UserError(f"the dataset's action says that {unknown} is ignored, but its names are {names}: correct one")
    return [names.index(name) for name in ignored]


def _range(key: str, stats: Stats) -> tuple[float, float]:
    """Least and greatest value of a feature; 0 and 0 where the statistics do not tell."""
    known = (stats or {}).get(key, {})
    low, high = (float(getattr(known[name], name)()) if name in known else 0.0 for name in ("min", "max"))
    return low, high
