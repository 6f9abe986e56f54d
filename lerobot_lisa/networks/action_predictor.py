"""Transformers that predict actions: LISA's policy over one chunk, and the flat Lang-DT over the whole episode."""

import torch
from torch import Tensor, nn

from lerobot_lisa.networks.actions import ActionHead
from lerobot_lisa.networks.packing import Packing
from lerobot_lisa.networks.timesteps import TimestepEmbedding
from lerobot_lisa.networks.transformer import CausalTransformer, Memory, after_prefix


class ActionPredictor(nn.Module):
    """A causal transformer over `[prefix ; o_0, a_0, o_1, a_1, ...]` that predicts each action from what precedes it.

    The prefix is all that the actions are conditioned on. LISA's policy pi gets the skill code as its only prefix token
    and sees one chunk (paper, section 4.1); Lang-DT gets the instruction tokens and sees the whole episode.
    """

    def __init__(self, timesteps: TimestepEmbedding, transformer: CausalTransformer, head: ActionHead) -> None:
        super().__init__()
        self.timesteps, self.transformer, self.head = timesteps, transformer, head

    def forward(
        self,
        prefix: Tensor,
        prefix_valid: Tensor | None,
        seen: Tensor,
        actions: Tensor,
        packing: Packing,
    ) -> Tensor:
        """Predict every action of B sequences (chunks or episodes) from the prefix and the steps up to it.

        Args:
            prefix: (B, M, D).
            prefix_valid: (B, M); None: all valid.
            seen: Observations of all N frames, embedded, (N, D).
            actions: (N, A), of which each prediction sees only those before it.
            packing: Where each sequence lies in the N frames.

        Returns:
            The head's predictions for all frames that are learned from.
        """
        when = self.timesteps(packing.steps)
        pairs = torch.stack([seen + when, self.head.embed(actions) + when], dim=1)
        frames = packing.pad(pairs.flatten(1)).unflatten(-1, (2, -1)).flatten(1, 2)  # (B, 2T, D)
        tokens = torch.cat([prefix, frames[:, :-1]], dim=1)  # nobody asks what follows the last action
        order = after_prefix(prefix.shape[1], torch.arange(2 * packing.longest - 1, device=prefix.device))
        asked = prefix.shape[1] + torch.arange(2 * packing.before, 2 * packing.longest, 2, device=prefix.device)
        valid = None if prefix_valid is None else _valid(prefix_valid, packing)
        return self.head(packing.unpad(self.transformer(tokens, order, valid, rows=asked)))

    def begin(self, prefix: Tensor, prefix_valid: Tensor | None = None) -> Memory:
        """Start a rollout: remember the prefix (B, M, D)."""
        memory = self.transformer.new_memory()
        self.transformer(
            prefix, after_prefix(prefix.shape[1], torch.arange(0, device=prefix.device)), prefix_valid, memory=memory
        )
        return memory

    def begin_anew(self, memory: Memory, prefix: Tensor, who: Tensor) -> None:
        """Let some of the batch (B,) begin another sequence, with its prefix of (B, M, D)."""
        memory.begin_anew(who)
        order = after_prefix(prefix.shape[1], torch.arange(0, device=prefix.device))
        self.transformer(prefix, order, who[:, None].expand(prefix.shape[:2]), memory=memory)

    def step(
        self, memory: Memory, step: int, seen: Tensor, previous_actions: Tensor | None, since: Tensor | None = None
    ) -> Tensor:
        """Predict the action of one more step.

        Args:
            memory: From `begin`.
            step: Counted from the rollout's start.
            seen: This step's observation, embedded, (B, D).
            previous_actions: Actions (B, A) of the step before; None where all sequences start.
            since: (B,) steps since each sequence's start; None: `step`, for all.

        Returns:
            The head's predictions (B, ...).
        """
        when = torch.tensor([step], device=seen.device) if since is None else since
        tokens, valid = [seen + self.timesteps(when)], None
        order = [2 * step]
        if previous_actions is not None:
            tokens.insert(0, self.head.embed(previous_actions) + self.timesteps((when - 1).clamp(min=0)))
            order.insert(0, 2 * step - 1)
            valid = torch.stack([when > 0, when >= 0], dim=1).expand(len(seen), 2)
        newest = torch.tensor([len(tokens) - 1], device=when.device)
        stacked = torch.stack(tokens, dim=1)
        out = self.transformer(stacked, torch.tensor(order, device=when.device), valid, newest, memory)
        return self.head(out[:, 0])


def _valid(prefix_valid: Tensor, packing: Packing) -> Tensor:
    """(B, M + 2T - 1)."""
    return torch.cat([prefix_valid, packing.valid.repeat_interleave(2, dim=1)[:, :-1]], dim=1)
