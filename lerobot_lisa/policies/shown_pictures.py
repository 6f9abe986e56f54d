"""Pictures that a rollout shows, made as large as those that a policy was trained on, whatever its cameras are."""

import logging

from lerobot.configs import FeatureType, PolicyFeature
from torch import Tensor

from lerobot_lisa.episodes.pictures import resized_shape, to_shape, with_longer_side
from lerobot_lisa.policies.base_configuration import EpisodePolicyConfig


class ShownPictures:
    """Makes pictures larger or smaller until their longer side has as many pixels as in training; aspects are kept."""

    def __init__(self, config: EpisodePolicyConfig) -> None:
        self._config = config
        self._warned: set[str] = set()

    def as_trained(self, key: str, value: Tensor, feature: PolicyFeature) -> Tensor:
        """One observation (B, *shape) of a feature, as the episode store would have it; no picture: as it is.

        Pictures come as bytes or in 0..1, and go as bytes if their size changes; those that the preprocessor has
        scaled are real numbers of any size, and stay so.
        """
        if feature.type is not FeatureType.VISUAL:
            return value
        height, width = feature.shape[-2:]
        trained = resized_shape(height, width, self._config.image_size)
        given = (value.shape[-2], value.shape[-1])
        shown = with_longer_side(*given, max(trained))
        if shown != trained or max(given) < max(trained):
            self._warn(key, given, (height, width), shown, trained)
        return to_shape(value, shown, as_numbers=self._config.is_scaled(FeatureType.VISUAL))

    def _warn(self, key: str, given: tuple[int, int], recorded: tuple[int, int], *made: tuple[int, int]) -> None:
        if key in self._warned:
            return
        self._warned.add(key)
        logging.warning(
            "`%s` shows pictures of %s pixels, the policy was trained on %s: they are made %s where those were %s, "
            "which it has never seen; set the camera to %s",
            key,
            *(" x ".join(map(str, shape)) for shape in (given, recorded, *made, recorded)),
        )
