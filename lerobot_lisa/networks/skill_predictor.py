"""LISA's upper level f: the instruction and all observations so far to one embedding per chunk of H steps."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from lerobot_lisa.networks.packing import Packing
from lerobot_lisa.networks.timesteps import TimestepEmbedding
from lerobot_lisa.networks.transformer import CausalTransformer, Memory, after_prefix


class SkillPredictor(nn.Module):
    """A causal transformer over `[instruction ; observations]` asked at steps 0, H, 2H, ... (paper, section 4.1).

    Actions are not part of its input. In training only the steps that are asked are computed in the last block.

    Args:
        timesteps: When observations were made.
        transformer: Whose window counts steps.
        width: D.
        stride: It looks at steps 0, stride, 2 * stride, ... and at none between them; H is a multiple of it.
    """

    def __init__(
        self, timesteps: TimestepEmbedding, transformer: CausalTransformer, width: int, stride: int = 1
    ) -> None:
        super().__init__()
        self.timesteps, self.transformer, self.stride = timesteps, transformer, stride
        self.output = nn.Linear(width, width)

    @property
    def reach(self) -> int:
        """How many steps before a question can matter to it."""
        return self.transformer.reach

    def forward(self, language: Tensor, language_valid: Tensor, seen: Tensor, packing: Packing, horizon: int) -> Tensor:
        """Whole episodes, or excerpts.

        Args:
            language: Instruction tokens (B, M, D).
            language_valid: (B, M).
            seen: Observations of the steps that it looks at, embedded, (N, D).
            packing: Where each of the B episodes lies among them.
            horizon: H, steps between two questions.

        Returns:
            Embeddings (C, D), one for each chunk of each episode that is learned from, in order.
        """
        frames, every = packing.pad(seen + self.timesteps(packing.steps)), horizon // self.stride
        order = after_prefix(language.shape[1], self.stride * torch.arange(packing.longest, device=language.device))
        asked = language.shape[1] + torch.arange(packing.before, packing.longest, every, device=language.device)
        tokens = torch.cat([language, frames], dim=1)
        valid = torch.cat([language_valid, packing.valid], dim=1)
        answers = self.transformer(tokens, order, valid, rows=asked)
        return self.output(packing.learned.count_chunks(every).unpad(answers))

    def begin(self, language: Tensor, language_valid: Tensor) -> Memory:
        """Start a rollout: remember the instruction tokens (B, M, D)."""
        memory = self.transformer.new_memory()
        nowhere = torch.arange(0, device=language.device)
        self.transformer(language, after_prefix(language.shape[1], nowhere), language_valid, memory=memory)
        return memory

    def ask(self, memory: Memory, seen: Tensor, when: Sequence[int]) -> Tensor:
        """Continue a rollout with the observations since the last question and ask at the newest of them.

        Args:
            memory: From `begin`.
            seen: Observations (B, n, D), embedded.
            when: Their n steps, counted from the episode's start.

        Returns:
            Embeddings (B, D).
        """
        steps = torch.tensor(when, device=seen.device)
        newest = torch.tensor([len(when) - 1], device=seen.device)
        answers = self.transformer(seen + self.timesteps(steps), steps, rows=newest, memory=memory)
        return self.output(answers[:, 0])
