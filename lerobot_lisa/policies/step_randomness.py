"""Random numbers of a training step, from a seed that its frames make: the same resumed or not."""

import hashlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import torch


@contextmanager
def drawing_from(batch: Mapping[str, Any], device: torch.device, *purpose: str) -> Iterator[None]:
    """Let a training step draw (dropout, codes to revive) from a seed that its frames make, in their order.

    LeRobot restores torch's generator when it resumes, but its loader then draws from it once more than without an
    interruption. Which frames make a step depends on `--seed` and the step alone, resumed or not.
    """
    frames = batch["index"]
    rank = torch.distributed.get_rank() if torch.distributed.is_initialized() else 0
    drawn = hashlib.blake2b(repr((rank, frames.reshape(-1).tolist(), *purpose)).encode(), digest_size=7)
    with torch.random.fork_rng([device] if device.type == "cuda" else []):
        torch.manual_seed(int.from_bytes(drawn.digest()))
        yield
