"""How pictures are made smaller: the same for the episode store and for what a policy is shown in a rollout.

Nothing is padded, cropped or distorted: the longer side gets `size` pixels and the shorter one follows.
"""

import torch
from torch import Tensor
from torch.nn.functional import interpolate


def resized_shape(height: int, width: int, size: int | None) -> tuple[int, int]:
    """Height and width after `resize`; pictures are never made larger."""
    if size is None or max(height, width) <= size:
        return height, width
    return with_longer_side(height, width, size)


def with_longer_side(height: int, width: int, side: int) -> tuple[int, int]:
    """Height and width of a picture whose longer side has been given `side` pixels, fewer or more than it had."""
    longer = max(height, width)
    return max(round(height * side / longer), 1), max(round(width * side / longer), 1)


def resize(pictures: Tensor, size: int | None) -> Tensor:
    """Make pictures smaller, each pixel a mean of those it stands for.

    Args:
        pictures: (..., channels, height, width), bytes, or real numbers in 0..1.
        size: Pixels of the longer side; None leaves all as it is.

    Returns:
        As bytes, of `resized_shape`, where `pictures` were.
    """
    return to_shape(as_bytes(pictures), resized_shape(pictures.shape[-2], pictures.shape[-1], size))


def to_shape(pictures: Tensor, shape: tuple[int, int], as_numbers: bool = False) -> Tensor:
    """Make pictures smaller or larger.

    Works on bytes and on the CPU, whatever comes in: so a picture that a policy is shown is, to the bit, the one that
    it would have been trained on.

    Args:
        pictures: (..., channels, height, width), bytes, or real numbers in 0..1.
        shape: Height and width that they get.
        as_numbers: They are real numbers of any size, and stay so.

    Returns:
        Pictures of that shape where `pictures` were; those that have it already as they are.
    """
    if shape == pictures.shape[-2:]:
        return pictures
    pictures = pictures if as_numbers else as_bytes(pictures)
    flat = pictures.reshape(-1, *pictures.shape[-3:]).cpu().contiguous(memory_format=torch.channels_last)
    made = interpolate(flat, size=shape, mode="bilinear", antialias=True).contiguous()
    return made.reshape(*pictures.shape[:-2], *shape).to(pictures.device)


def as_bytes(pictures: Tensor) -> Tensor:
    """Real numbers in 0..1 as bytes, in which cameras and datasets have them."""
    return pictures if pictures.dtype == torch.uint8 else (pictures * 255).round().to(torch.uint8)
