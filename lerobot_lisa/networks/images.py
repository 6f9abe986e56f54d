"""Pictures: three convolutions or a pretrained backbone, as a whole and as patches."""

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from lerobot_lisa.networks.backbones import Backbone
from lerobot_lisa.networks.parts import OwnKeys, Parts


class ImageEncoder(nn.Module):
    """Images: three strided convolutions (paper, section 4.1), pooled to 4 x 4 so that any image size works.

    The first one quarters the resolution at once. Four that halve it, one after another, spend most of their time on
    the large maps: a seventh as many images per second on a CPU.
    """

    features, patches = 64, 16

    def __init__(self, channels: int, width: int) -> None:
        super().__init__()
        self.convolutions = nn.Sequential(
            nn.Conv2d(channels, 32, 5, stride=4, padding=2),
            nn.ReLU(inplace=True),
            nn.Conv2d(32, 64, 3, stride=2, padding=1),
            nn.ReLU(inplace=True),
            nn.Conv2d(64, 64, 3, stride=2, padding=1),
            nn.ReLU(inplace=True),
            nn.AdaptiveAvgPool2d(4),
        )
        self.output = nn.Linear(64 * 16, width)

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """(N, channels, height, width), uint8 in 0..255 or real in 0..1 -> whole (N, D) and patches (N, 16, 64)."""
        patches = self.convolutions(_unit_range(images))
        return self.output(patches.flatten(1)), patches.flatten(2).transpose(1, 2)


class FeatureEncoder(nn.Module):
    """What a backbone says of pictures, at unit scale whichever it is, and a linear layer.

    Args:
        shape: Of a picture's features, see `Backbone.shape`.
        width: D.
    """

    def __init__(self, shape: tuple[int, ...], width: int) -> None:
        super().__init__()
        self.patches, self.features = shape[0] - 1, shape[1]
        self.output = nn.Linear(self.features, width)

    def forward(self, features: Tensor) -> tuple[Tensor, Tensor]:
        """(N, 1 + P, F) -> whole (N, D) and patches (N, P, F)."""
        features = F.layer_norm(features, features.shape[-1:])
        return self.output(features[:, 0]), features[:, 1:]


class BackboneEncoder(FeatureEncoder):
    """Pictures through a backbone that learns with the rest."""

    def __init__(self, backbone: Backbone, width: int) -> None:
        super().__init__(backbone.shape, width)
        self.backbone = backbone

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """(N, 3, height, width), uint8 in 0..255 or real in 0..1 -> whole (N, D) and patches (N, P, F)."""
        return super().forward(self.backbone(images))


class PatchParts(nn.Module):
    """Patches as parts: keys and values are learned from their features.

    Args:
        patches: How many there are.
        features: Of each.
        words: W.
        values: C.
    """

    def __init__(self, patches: int, features: int, words: int, values: int) -> None:
        super().__init__()
        self.keys, self.values = nn.Linear(features, words), nn.Linear(features, values)
        self.places = nn.Embedding(patches, values)

    def forward(self, patches: Tensor) -> Parts:
        """Patches (N, P, features) to parts."""
        places = torch.arange(patches.shape[1], device=patches.device).expand(patches.shape[:2])
        values = self.values(patches) + self.places(places)
        return Parts((OwnKeys(self.keys(patches)),), values, values.new_zeros(places.shape), places)


def _unit_range(images: Tensor) -> Tensor:
    """Real numbers in 0..1 with channels last in memory, which convolutions take half again as fast on a CPU."""
    images = images.contiguous(memory_format=torch.channels_last)  # bytes first: a quarter of what real numbers take
    return images.float().div_(255) if images.dtype == torch.uint8 else images.float()
