"""Which features the networks can take; everything else is refused with a sentence that says how to mend it."""

import math
from typing import TYPE_CHECKING

from lerobot.configs import FeatureType, NormalizationMode, PolicyFeature

from lerobot_lisa.errors import UserError

if TYPE_CHECKING:
    from lerobot_lisa.policies.base_configuration import EpisodePolicyConfig


def check_features(config: "EpisodePolicyConfig") -> None:
    """Refuse features that cannot work; see `EpisodePolicyConfig.validate_features`."""
    if not config.input_features:
        raise UserError(
            f"{config.type} needs at least one observation.* feature (grid, state or image): the dataset has none"
        )
    for key, feature in config.input_features.items():
        _check_observation(config, key, feature)
    action = config.action_feature
    if action is None:
        raise UserError(
            f"{config.type} needs a feature called `action`: the dataset has {sorted(config.output_features or {})}"
        )
    if len(action.shape) != 1:
        raise UserError(f"{config.type} takes a flat action, but `action` has shape {tuple(action.shape)}: flatten it")
    _check_action(config, action)


def _check_observation(config: "EpisodePolicyConfig", key: str, feature: PolicyFeature) -> None:
    if feature.type not in (FeatureType.STATE, FeatureType.ENV, FeatureType.VISUAL):
        raise UserError(
            f"{config.type} cannot read `{key}` of type {feature.type.value}: leave it out of --policy.input_features"
        )
    if feature.type is FeatureType.VISUAL and len(feature.shape) != 3:
        raise UserError(f"image `{key}` has shape {tuple(feature.shape)}: it must be (channels, height, width)")
    if math.prod(feature.shape) == 0:
        raise UserError(f"`{key}` has the empty shape {tuple(feature.shape)}: leave it out of --policy.input_features")


def _check_action(config: "EpisodePolicyConfig", action: PolicyFeature) -> None:
    if config.action_classes:
        if action.shape[0] != 1:
            raise UserError(
                f"a categorical action has shape (1,), this one {tuple(action.shape)}: "
                "pass --policy.action_classes=0 to treat it as real numbers"
            )
        if config.normalization_mapping.get("ACTION", NormalizationMode.IDENTITY) is not NormalizationMode.IDENTITY:
            raise UserError("a categorical action cannot be normalised: set normalization_mapping ACTION to IDENTITY")
    ignored = config.ignored_action_dimensions or []
    outside = [d for d in ignored if not 0 <= d < action.shape[0]]
    if outside or len(set(ignored)) >= action.shape[0]:
        raise UserError(
            f"--policy.ignored_action_dimensions={ignored} must leave at least one of the "
            f"{action.shape[0]} dimensions 0..{action.shape[0] - 1}"
        )
    if config.normalization_mapping.get("ENV", NormalizationMode.IDENTITY) is not NormalizationMode.IDENTITY:
        raise UserError(
            "ENV features hold symbols, which cannot be normalised: set normalization_mapping ENV to IDENTITY"
        )
