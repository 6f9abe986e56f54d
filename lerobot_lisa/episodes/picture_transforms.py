"""Changes the pictures of whole episodes by LeRobot's own image transforms, one draw for each episode and camera."""

from collections.abc import Iterable, Mapping

import torch
from lerobot.transforms import ImageTransforms, ImageTransformsConfig
from torch import Tensor

from lerobot_lisa.errors import UserError
from lerobot_lisa.networks.packing import Packing


class PictureTransforms:
    """What `--dataset.image_transforms` does to single frames, done to episodes.

    All frames of an episode are changed alike: a camera whose colours jump at every step would be another world.

    Args:
        config: LeRobot's.

    Raises:
        UserError: A transform is unknown, or does not take what it is given.
    """

    def __init__(self, config: ImageTransformsConfig) -> None:
        try:
            self._transforms = ImageTransforms(config)
        except (ValueError, TypeError) as error:
            reason = " ".join(str(error).split())
            raise UserError(f"--policy.image_transforms: {reason:.300}: see LeRobot's ImageTransformsConfig") from error

    def __call__(self, frames: Mapping[str, Tensor], keys: Iterable[str], packing: Packing) -> dict[str, Tensor]:
        """Draw from torch's generator.

        Args:
            frames: Features of all N frames.
            keys: Those that are pictures, (N, channels, height, width).
            packing: Where each episode lies in the N frames.
        """
        lengths = packing.lengths.tolist()
        changed = {key: torch.cat([self._transforms(part) for part in frames[key].split(lengths)]) for key in keys}
        return {**frames, **changed}
