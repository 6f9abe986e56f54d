"""Pictures: three convolutions or a pretrained backbone, as a whole and as patches."""

import torch
from torch import Tensor, nn

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
            nn.ReLU(),
            nn.Conv2d(32, 64, 3, stride=2, padding=1),
            nn.ReLU(),
            nn.Conv2d(64, 64, 3, stride=2, padding=1),
            nn.ReLU(),
            nn.AdaptiveAvgPool2d(4),
        )
        self.output = nn.Linear(64 * 16, width)

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """(N, channels, height, width), uint8 in 0..255 or real in 0..1 -> whole (N, D) and patches (N, 16, 64)."""
        patches = self.convolutions(_unit_range(images))
        return self.output(patches.flatten(1)), patches.flatten(2).transpose(1, 2)


class BackboneEncoder(nn.Module):
    """Images through a torchvision resnet, such as `resnet18`: the mean of its last map and a linear layer."""

    mean: Tensor
    std: Tensor
    patches = 49

    def __init__(self, name: str, weights: str | None, channels: int, width: int) -> None:
        super().__init__()
        import torchvision  # slow to import, and only image policies with a backbone need it

        if channels != 3:
            raise ValueError(f"image backbone {name} needs 3 channels, the feature has {channels}")
        model = torchvision.models.get_model(name, weights=weights)
        if not isinstance(getattr(model, "fc", None), nn.Linear) or not hasattr(model, "layer4"):
            raise ValueError(f"image backbone {name} has no final layer called fc: choose a resnet")
        self.features: int = model.fc.in_features
        model.fc = model.avgpool = nn.Identity()
        self.model, self.output = model, nn.Linear(self.features, width)
        self.pool = nn.AdaptiveAvgPool2d(7)
        mean, std = torch.tensor([0.485, 0.456, 0.406]), torch.tensor([0.229, 0.224, 0.225])  # ImageNet's
        self.register_buffer("mean", mean.view(3, 1, 1), persistent=False)
        self.register_buffer("std", std.view(3, 1, 1), persistent=False)

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """(N, 3, height, width), uint8 in 0..255 or real in 0..1 -> whole (N, D) and patches (N, 49, features)."""
        last = self._last_map((_unit_range(images) - self.mean) / self.std)
        return self.output(last.mean((2, 3))), self.pool(last).flatten(2).transpose(1, 2)

    def _last_map(self, images: Tensor) -> Tensor:
        """(N, features, height, width), what torchvision's resnet averages before its last layer."""
        model = self.model
        x = model.maxpool(model.relu(model.bn1(model.conv1(images))))
        return model.layer4(model.layer3(model.layer2(model.layer1(x))))


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
    real = images.float() / 255 if images.dtype == torch.uint8 else images.float()
    return real.contiguous(memory_format=torch.channels_last)
