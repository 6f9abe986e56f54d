"""Which features and scalings are refused: those that the networks cannot take. One line each, with what to do."""

from lerobot.configs import FeatureType, PolicyFeature

from lerobot_lisa.errors import UserError
from lerobot_lisa.policies.accepted_settings import short
from lerobot_lisa.policies.episode_settings import EpisodeSettings


def check_observation(config: EpisodeSettings, key: str, feature: PolicyFeature) -> None:
    """A type that is seen, of a shape that its encoder takes."""
    kind, shape = feature.type, tuple(feature.shape)
    if kind not in (FeatureType.STATE, FeatureType.ENV, FeatureType.VISUAL):
        raise UserError(
            f"{config.type} cannot read `{key}` of type {kind.value}: leave it out of --policy.input_features"
        )
    if kind is FeatureType.VISUAL and len(shape) != 3:
        raise UserError(f"image `{key}` has shape {shape}: it must be (channels, height, width)")
    if any(side < 1 for side in shape):
        raise UserError(f"`{key}` has the empty shape {shape}: leave it out of --policy.input_features")
    if kind is FeatureType.VISUAL and config.is_scaled(kind) and max(shape[1:]) > (config.image_size or max(shape)):
        raise UserError(
            f"image `{key}` is made smaller to {config.image_size} pixels, so it cannot be normalised before: set "
            "normalization_mapping VISUAL to IDENTITY (encoders scale pictures themselves), or "
            "--policy.image_size=null"
        )


def check_symbols(config: EpisodeSettings) -> None:
    """They stay as they are."""
    if config.is_scaled(FeatureType.ENV):
        raise UserError(
            "ENV features hold symbols, which cannot be normalised: set normalization_mapping ENV to IDENTITY"
        )


def check_action(config: EpisodeSettings) -> None:
    """Flat; one number if it is a choice."""
    action = config.action_feature
    if action is None:
        raise UserError(
            f"{config.type} needs a feature called `action`: the dataset has {sorted(config.output_features or {})}"
        )
    if len(action.shape) != 1:
        raise UserError(f"{config.type} takes a flat action, but `action` has shape {tuple(action.shape)}: flatten it")
    if config.action_classes:
        _check_choice_of_actions(config, action.shape[0])
    _check_ignored(config, action.shape[0])


def check_frozen_backbone(config: EpisodeSettings) -> None:
    """What it is asked once cannot change afterwards."""
    if not config.freeze_vision_backbone:
        return
    if config.vision_backbone is None:
        raise UserError("--policy.freeze_vision_backbone=true needs a --policy.vision_backbone to keep as it is")
    if config.image_transforms.enable or config.is_scaled(FeatureType.VISUAL):
        raise UserError(
            "a frozen vision backbone is asked once for each frame, as it was recorded: set normalization_mapping "
            "VISUAL to IDENTITY and --policy.image_transforms.enable=false, or freeze_vision_backbone=false"
        )


def _check_choice_of_actions(config: EpisodeSettings, numbers: int) -> None:
    if numbers != 1:
        raise UserError(
            f"the policy chooses one of {config.action_classes} actions, but `action` here has {numbers} "
            "numbers: evaluate it in the world it was trained in (for integers of a dataset that are no choices, "
            "pass --policy.action_classes=0)"
        )
    if config.is_scaled(FeatureType.ACTION):
        raise UserError("a categorical action cannot be normalised: set normalization_mapping ACTION to IDENTITY")


def _check_ignored(config: EpisodeSettings, numbers: int) -> None:
    ignored = config.ignored_action_dimensions or []
    outside = [d for d in ignored if not 0 <= d < numbers]
    if outside or len(set(ignored)) >= numbers:
        raise UserError(
            f"--policy.ignored_action_dimensions={short(ignored)} must leave at least one of the "
            f"{numbers} dimensions 0..{numbers - 1}"
        )
