"""A judge of what was told: has it been done between two states?"""

from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from lerobot_lisa.networks.mlp import hidden_layers

OTHERS = 8  # instructions of other episodes that each episode is held against


class Judged(NamedTuple):
    """What the judge said of a batch.

    Attributes:
        judge_loss: Scalar.
        judge_accuracy: Scalar, share of right answers, true and false ones counted alike.
    """

    judge_loss: Tensor
    judge_accuracy: Tensor


class Judge(nn.Module):
    """A binary classifier.

    Args:
        size: S, numbers of a state.
        width: D.
        dropout: In its layers.
    """

    def __init__(self, size: int, width: int, dropout: float) -> None:
        super().__init__()
        self.layers = nn.Sequential(hidden_layers(3 * size + width, width, dropout), nn.Linear(width, 1))

    def forward(self, start: Tensor, states: Tensor, sentences: Tensor) -> Tensor:
        """Logits (N,) of "what was told (N, D) has been done since the start (N, S), now that states (N, S) are so"."""
        logits: Tensor = self.layers(torch.cat([start, states, states - start, sentences], dim=-1))[:, 0]
        return logits

    def learn(self, first: Tensor, last: Tensor, sentences: Tensor, tokens: Tensor, valid: Tensor) -> Judged:
        """What B episodes say: their instruction is done at their end, and so is what is said within it.

        What others were told is not, unless all of its words were said here, too: of many things done at once, an
        instruction may name any. Nor is an episode's own instruction done backwards.

        Args:
            first: First states (B, S).
            last: Last ones.
            sentences: What was told, (B, D).
            tokens: The same as tokens (B, M).
            valid: Which of them are real, (B, M).
        """
        own, other = _pairs(len(tokens), self.training, tokens.device)
        told = tokens.masked_fill(~valid, -1)
        within, may_be = _is_part(told[other], told[own]), _is_made_of(told[other], told[own])
        moved = (first != last).any(1)
        mine, theirs = self(first, last, sentences), self(first[own], last[own], sentences[other])
        kinds = [
            (torch.cat([mine, theirs]), torch.cat([moved, moved[own] & within]), 1.0),
            (theirs, moved[own] & ~may_be, 0.0),
            (self(last, first, sentences), moved, 0.0),
        ]
        losses = [_mean(_cross_entropy(logits, answer), counts) for logits, counts, answer in kinds]
        right = [_mean(((logits > 0) == bool(answer)).float(), counts) for logits, counts, answer in kinds]
        return Judged(*(part[0] / 2 + (part[1] + part[2]) / 4 for part in (losses, right)))


def _pairs(episodes: int, random: bool, device: torch.device) -> tuple[Tensor, Tensor]:
    """Episodes, and for each of them some others, whose instructions it is held against."""
    turns = torch.randperm(episodes - 1)[:OTHERS] if random else torch.arange(min(episodes - 1, OTHERS))
    own = torch.arange(episodes).repeat(len(turns))
    other = (own + 1 + turns.repeat_interleave(episodes)) % episodes
    return own.to(device), other.to(device)


def _is_part(inner: Tensor, outer: Tensor) -> Tensor:
    """Whether the tokens (N, M) are said one after another in others, -1 at the end of both, (N,)."""
    windows = F.pad(outer, (0, outer.shape[1]), value=-1).unfold(1, outer.shape[1], 1)
    return ((windows == inner[:, None]) | (inner[:, None] < 0)).all(2).any(1)


def _is_made_of(inner: Tensor, outer: Tensor) -> Tensor:
    """Whether all of the tokens (N, M) are said in others, in whatever order, (N,)."""
    return ((inner[:, :, None] == outer[:, None]).any(2) | (inner < 0)).all(1)


def _cross_entropy(logits: Tensor, answer: float) -> Tensor:
    return F.binary_cross_entropy_with_logits(logits.float(), torch.full_like(logits, answer).float(), reduction="none")


def _mean(values: Tensor, counts: Tensor) -> Tensor:
    """Of those that count; 0 if none does."""
    return (values * counts).sum() / counts.sum().clamp(min=1)
