"""What the skill predictor says to the quantiser: phrases copied from the instruction, or numbers of its own."""

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from lerobot_lisa.networks.language import Instruction

SHARPNESS = 2.0
"""Bound of a pointer's scores. The first of two goals is right for most of an episode; a pointer that grows ever more
certain of it never learns when it is reached."""


class PhraseCopier(nn.Module):
    """Points at tokens of the instruction and takes their phrases along: a pointer network (arXiv:1506.03134).

    What the quantiser gets then lies in the space of words, so that a code can be read, asked with and set by name.

    The first part points at names of things, where things have names. A mixture of all words of a long instruction is
    so little like any of its things that none answers when asked by it, and where nothing answers there is nothing to
    learn from; and "to" is no thing, but was used as a signal of its own.

    Once there are codes a phrase is copied whole: mixtures have no names, and codes would stand between phrases.

    Args:
        width: D.
        words: W.
        parts: How many phrases a skill is made of, such as what to do and with what.
        own: How many further parts it makes up, for what nobody says: where to search, whether to turn back.
        own_width: How many numbers each of these is; few, so that as few codes can stand for them.
    """

    def __init__(self, width: int, words: int, parts: int, own: int = 0, own_width: int = 16) -> None:
        super().__init__()
        self.parts, self.width = parts, words
        self.own = nn.ModuleList(
            nn.Sequential(nn.Linear(width, own_width), nn.LayerNorm(own_width), nn.Linear(own_width, words))
            for _ in range(own)
        )
        self.query, self.key = nn.Linear(width, parts * width), nn.Linear(width, width)

    def forward(self, answers: Tensor, instruction: Instruction, whole: bool = True) -> Tensor:
        """What the skill predictor says.

        Args:
            answers: (C, D), its output.
            instruction: The C instructions that they are about.
            whole: Copy the phrase that is pointed at most, instead of all of them as far as they are pointed at; the
                gradient is the mixture's.

        Returns:
            (C, parts + own, W).
        """
        pointers = self.pointers(answers, instruction)
        if whole:
            most = F.one_hot(pointers.argmax(-1), pointers.shape[-1]).to(pointers.dtype)
            pointers = pointers + (most - pointers).detach()
        phrases = pointers @ instruction.phrases
        return torch.cat([phrases, *(own(answers)[:, None] for own in self.own)], dim=1)

    def pointers(self, answers: Tensor, instruction: Instruction) -> Tensor:
        """Where in the instructions each part points, (C, parts, M)."""
        query = F.normalize(self.query(answers).unflatten(-1, (self.parts, -1)), dim=-1)
        scores = SHARPNESS * query @ F.normalize(self.key(instruction.tokens), dim=-1).transpose(1, 2)
        allowed = instruction.valid[:, None].repeat(1, self.parts, 1)
        allowed[:, 0] &= instruction.ends
        return scores.masked_fill(~allowed, float("-inf")).softmax(-1)


class OwnNumbers(nn.Module):
    """The paper's form (section 3.2): the quantiser gets the skill predictor's own output."""

    def __init__(self, width: int, parts: int) -> None:
        super().__init__()
        self.parts, self.width = parts, width
        self.output = nn.Linear(width, parts * width) if parts > 1 else nn.Identity()

    def forward(self, answers: Tensor, instruction: Instruction, whole: bool = True) -> Tensor:
        """Answers (C, D) -> (C, parts, D); the instruction has been heard already, and `whole` means nothing."""
        return self.output(answers).unflatten(-1, (self.parts, -1))
