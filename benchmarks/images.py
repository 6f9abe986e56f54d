"""The image encoder, forward and backward, against the obvious one: every convolution halves the resolution."""

import argparse
from collections.abc import Callable
from itertools import pairwise

import torch
from torch import Tensor, nn

from benchmarks.measuring import contest
from benchmarks.table import Row, ratio_row
from lerobot_lisa.networks.observations import ImageEncoder

SIZE, WIDTH = 64, 128
IMAGES = 640  # 32 episodes of LOReL


class HalvingEncoder(nn.Module):
    """Four convolutions of stride 2, to the same 4 x 4 places of 64 numbers."""

    def __init__(self) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        for before, after in pairwise([3, 32, 64, 64, 64]):
            layers += [nn.Conv2d(before, after, 3, stride=2, padding=1), nn.GELU()]
        self.layers = nn.Sequential(*layers, nn.Flatten(), nn.Linear(64 * 16, WIDTH))

    def forward(self, images: Tensor) -> Tensor:
        """Images (N, 3, 64, 64), uint8 -> (N, D)."""
        return self.layers(images.float() / 255)


def rows(options: argparse.Namespace) -> list[Row]:
    images = torch.randint(0, 256, (IMAGES, 3, SIZE, SIZE), dtype=torch.uint8)
    result = contest(_trains(ImageEncoder(3, WIDTH), images), _trains(HalvingEncoder(), images), options.repeats)
    return [
        ratio_row("images of 64 x 64 encoded in training", "four convolutions of stride 2", 3, result, "images"),
    ]


def _trains(encoder: nn.Module, images: Tensor) -> Callable[[], float]:
    def work() -> float:
        encoder(images).square().mean().backward()
        return len(images)

    return work
