"""Observation encoders, one per kind of feature, summed into one embedding per frame."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor, nn


@dataclass(frozen=True)
class ObservationSpec:
    """What one observation feature holds.

    Attributes:
        kind: "symbols" (small integers, each position an own vocabulary), "state" (real numbers) or "image".
        shape: Shape of one frame's value; images are (channels, height, width).
        symbols: How many different values a symbol can take; only for "symbols".
    """

    kind: Literal["symbols", "state", "image"]
    shape: tuple[int, ...]
    symbols: int = 0


class SymbolEncoder(nn.Module):
    """Symbolic grids and categories: the sum of one embedding per (position, symbol), then a residual MLP.

    The bag of embeddings is BabyAI 1.1's (arXiv:2007.12770): embedding symbols instead of treating them as numbers was
    one of its three gains. Positions keep their own tables, which stands in for that paper's convolutions at a
    hundredth of their cost on a CPU.
    """

    offsets: Tensor

    def __init__(self, positions: int, symbols: int, width: int) -> None:
        super().__init__()
        self.symbols = symbols
        self.bag = nn.EmbeddingBag(positions * symbols, width, mode="sum")
        nn.init.normal_(self.bag.weight, std=0.1)
        self.mlp = nn.Sequential(
            nn.LayerNorm(width), nn.Linear(width, 2 * width), nn.GELU(), nn.Linear(2 * width, width)
        )
        self.register_buffer("offsets", torch.arange(positions) * symbols, persistent=False)

    def forward(self, symbols: Tensor) -> Tensor:
        """(N, positions) of any numeric dtype -> (N, D). Symbols outside the vocabulary count as its last one."""
        rows = symbols.flatten(1).long().clamp(0, self.symbols - 1) + self.offsets
        summed = self.bag(rows)
        return summed + self.mlp(summed)


class StateEncoder(nn.Module):
    """State vectors: a two-layer MLP (paper, section 4.1, "Observation Encoder")."""

    def __init__(self, size: int, width: int) -> None:
        super().__init__()
        self.mlp = nn.Sequential(nn.Linear(size, width), nn.GELU(), nn.Linear(width, width))

    def forward(self, state: Tensor) -> Tensor:
        """(N, ...) real numbers -> (N, D)."""
        return self.mlp(state.flatten(1).float())


class ImageEncoder(nn.Module):
    """Images: three strided convolutions (paper, section 4.1), pooled to 4 x 4 so that any image size works.

    The first one quarters the resolution at once. Four that halve it, one after another, spend most of their time on
    the large maps: a seventh as many images per second on a CPU.
    """

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

    def forward(self, images: Tensor) -> Tensor:
        """(N, channels, height, width), uint8 in 0..255 or real in 0..1 -> (N, D)."""
        return self.output(self.convolutions(_unit_range(images)).flatten(1))


class BackboneEncoder(nn.Module):
    """Images through a torchvision classifier without its last layer, such as `resnet18`, and a linear layer."""

    mean: Tensor
    std: Tensor

    def __init__(self, name: str, weights: str | None, channels: int, width: int) -> None:
        super().__init__()
        import torchvision  # slow to import, and only image policies with a backbone need it

        if channels != 3:
            raise ValueError(f"image backbone {name} needs 3 channels, the feature has {channels}")
        model = torchvision.models.get_model(name, weights=weights)
        if not isinstance(getattr(model, "fc", None), nn.Linear):
            raise ValueError(f"image backbone {name} has no final layer called fc: choose a resnet")
        features = model.fc.in_features
        model.fc = nn.Identity()
        self.model, self.output = model, nn.Linear(features, width)
        mean, std = torch.tensor([0.485, 0.456, 0.406]), torch.tensor([0.229, 0.224, 0.225])  # ImageNet's
        self.register_buffer("mean", mean.view(3, 1, 1), persistent=False)
        self.register_buffer("std", std.view(3, 1, 1), persistent=False)

    def forward(self, images: Tensor) -> Tensor:
        """(N, 3, height, width), uint8 in 0..255 or real in 0..1 -> (N, D)."""
        return self.output(self.model((_unit_range(images) - self.mean) / self.std))


def _unit_range(images: Tensor) -> Tensor:
    """Real numbers in 0..1 with channels last in memory, which convolutions take half again as fast on a CPU."""
    real = images.float() / 255 if images.dtype == torch.uint8 else images.float()
    return real.contiguous(memory_format=torch.channels_last)


class ObservationEncoder(nn.Module):
    """All observation features of a frame, each through the encoder of its kind, summed."""

    def __init__(
        self,
        specs: Mapping[str, ObservationSpec],
        width: int,
        backbone: str | None = None,
        backbone_weights: str | None = None,
    ) -> None:
        super().__init__()
        self.symbolic = [key for key, spec in specs.items() if spec.kind == "symbols"]
        self.encoders = nn.ModuleDict()
        if self.symbolic:
            positions = sum(torch.Size(specs[key].shape).numel() for key in self.symbolic)
            symbols = max(specs[key].symbols for key in self.symbolic)
            self.encoders["symbols"] = SymbolEncoder(positions, symbols, width)
        self.others = {key: key.replace(".", "_") for key in specs if key not in self.symbolic}
        for key, name in self.others.items():
            self.encoders[name] = self._encoder(specs[key], width, backbone, backbone_weights)

    @staticmethod
    def _encoder(spec: ObservationSpec, width: int, backbone: str | None, weights: str | None) -> nn.Module:
        if spec.kind == "state":
            return StateEncoder(torch.Size(spec.shape).numel(), width)
        if backbone is None:
            return ImageEncoder(spec.shape[0], width)
        return BackboneEncoder(backbone, weights, spec.shape[0], width)

    def forward(self, observations: Mapping[str, Tensor]) -> Tensor:
        """Features of N frames, each (N, *shape) -> (N, D)."""
        embedded = [self.encoders[name](observations[key]) for key, name in self.others.items()]
        if self.symbolic:
            symbols = torch.cat([observations[key].flatten(1) for key in self.symbolic], dim=1)
            embedded.append(self.encoders["symbols"](symbols))
        return torch.stack(embedded).sum(0) if len(embedded) > 1 else embedded[0]
