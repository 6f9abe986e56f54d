"""Random numbers of training steps: the same after resuming as without an interruption."""

from collections.abc import Iterator
from contextlib import contextmanager

import torch
from torch import Tensor, nn


class StepRandomness(nn.Module):
    """Makes what a training step draws (dropout, codes to revive) depend on a seed and the step's number alone.

    LeRobot restores torch's generator when it resumes, but then its loader draws from it once more than without an
    interruption. The seed is drawn from that generator at first; both numbers are saved with the weights.
    """

    seed: Tensor
    steps: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("seed", torch.randint(2**31, ()))
        self.register_buffer("steps", torch.zeros((), dtype=torch.int64))

    @contextmanager
    def next_step(self) -> Iterator[None]:
        """Draw as this step does, then let others go on where they were; in evaluation mode, do nothing."""
        if not self.training:
            yield
            return
        rank = torch.distributed.get_rank() if torch.distributed.is_initialized() else 0
        devices = [self.seed.device] if self.seed.device.type == "cuda" else []
        with torch.random.fork_rng(devices):
            torch.manual_seed((rank << 56) + (int(self.seed) << 24) + int(self.steps) % 2**24)
            yield
        self.steps += 1
