"""Backbones that somebody else has trained: pictures to features, of the whole and of patches."""

import hashlib
import math
from collections.abc import Sequence
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn


class Backbone(nn.Module):
    """Pictures through a model of torchvision or `transformers`.

    Args:
        model: Pictures (N, 3, height, width) to a summary (N, F), None for the patches' mean, and a map (N, F, h, w).
        features: F.
        mean: Of the pictures that the model was trained on, by channel.
        std: Their deviation.
        picture_size: Height and width that the model wants; None: as they come.
        side: Patches along a side of the map that is kept.
    """

    mean: Tensor
    std: Tensor

    def __init__(
        self,
        model: nn.Module,
        features: int,
        mean: Sequence[float],
        std: Sequence[float],
        picture_size: tuple[int, int] | None = None,
        side: int = 4,
    ) -> None:
        super().__init__()
        self.model, self.features, self.picture_size, self.side = model, features, picture_size, side
        self.register_buffer("mean", torch.tensor(mean).view(-1, 1, 1), persistent=False)
        self.register_buffer("std", torch.tensor(std).view(-1, 1, 1), persistent=False)

    @property
    def shape(self) -> tuple[int, int]:
        """Of one picture's features: 1 + P rows of F numbers."""
        return 1 + self.side**2, self.features

    def forward(self, pictures: Tensor) -> Tensor:
        """(N, 3, height, width), bytes or real in 0..1 -> (N, 1 + P, F), the whole first, then patches row by row."""
        pictures = pictures.float() / 255 if pictures.dtype == torch.uint8 else pictures.float()
        if self.picture_size not in (None, tuple(pictures.shape[-2:])):
            pictures = F.interpolate(pictures, size=self.picture_size, mode="bilinear", antialias=True)
        whole, last = self.model((pictures - self.mean) / self.std)
        patches = F.adaptive_avg_pool2d(last, self.side).flatten(2).transpose(1, 2)
        return torch.cat([(last.mean((2, 3)) if whole is None else whole)[:, None], patches], dim=1)


class FrozenBackbone(Backbone):
    """One that stays as it is, and is asked once for each picture."""

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self.requires_grad_(False).eval()

    def train(self, mode: bool = True) -> "FrozenBackbone":
        """Stay in evaluation mode: dropout and batch statistics would make answers differ each time."""
        return super().train(False)

    @torch.no_grad()
    def forward(self, pictures: Tensor) -> Tensor:
        """As `Backbone`, in full precision whatever a training step has: what is kept is for rollouts, too."""
        with torch.autocast(pictures.device.type, enabled=False):
            return super().forward(pictures)

    def fingerprint(self) -> str:
        """Changes with whatever changes the features."""
        settings = (type(self.model).__name__, self.mean.tolist(), self.std.tolist(), self.picture_size, self.side)
        drawn = hashlib.sha256(repr(settings).encode())
        for name, value in self.model.state_dict().items():
            drawn.update(name.encode() + value.detach().cpu().reshape(-1).view(torch.uint8).numpy().tobytes())
        return drawn.hexdigest()[:32]


class ResnetMap(nn.Module):
    """A torchvision resnet, such as `resnet18`, up to its last map."""

    def __init__(self, model: Any) -> None:
        super().__init__()
        self.features: int = model.fc.in_features
        model.fc = model.avgpool = nn.Identity()
        self.resnet = model

    def forward(self, pictures: Tensor) -> tuple[None, Tensor]:
        """What torchvision averages before its last layer."""
        net = self.resnet
        x = net.maxpool(net.relu(net.bn1(net.conv1(pictures))))
        return None, net.layer4(net.layer3(net.layer2(net.layer1(x))))


class TransformersMap(nn.Module):
    """A vision model of `transformers`: convolutions, or tokens of patches behind a few tokens of other things.

    Args:
        model: With a `last_hidden_state` in its output.
        patch_size: Height and width of what a token stands for; None for convolutions.
    """

    def __init__(self, model: Any, patch_size: tuple[int, int] | None) -> None:
        super().__init__()
        self.model, self.patch_size = model, patch_size

    def forward(self, pictures: Tensor) -> tuple[Tensor | None, Tensor]:
        """Summary, if the model makes one, and the map."""
        output = self.model(pixel_values=pictures)
        last, whole = output.last_hidden_state, getattr(output, "pooler_output", None)
        if last.dim() == 3:
            height, width = self._grid(last.shape[1], pictures.shape[-2], pictures.shape[-1])
            last = last[:, -height * width :].transpose(1, 2).unflatten(2, (height, width))
        return None if whole is None else whole.flatten(1), last

    def _grid(self, tokens: int, height: int, width: int) -> tuple[int, int]:
        """Rows and columns of patches; models that merge patches, such as Swin, have a square of them and no others."""
        if self.patch_size is not None:
            rows, columns = height // self.patch_size[0], width // self.patch_size[1]
            if rows * columns <= tokens:
                return rows, columns
        side = math.isqrt(tokens)
        if side * side != tokens:
            raise ValueError(f"its {tokens} tokens are no map")
        return side, side
