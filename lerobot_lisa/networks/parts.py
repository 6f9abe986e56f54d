"""What an observation consists of, and asking it: parts with keys among words, and attention from words to them."""

from typing import NamedTuple, Protocol

import torch
import torch.nn.functional as F
from torch import Tensor, nn


class Keys(Protocol):
    """What the parts of N frames can be asked by, in the space of words."""

    def match(self, asked: Tensor, rows: Tensor | None) -> Tensor:
        """Products of keys and questions.

        Args:
            asked: (B, Q, W).
            rows: (N,) whose questions each frame is asked; None: frame i is asked questions i.

        Returns:
            (N, Q, P).
        """

    def take(self, frames: Tensor) -> "Keys":
        """Those of some of the frames, whose numbers grow."""


class OwnKeys(NamedTuple):
    """Each part of each frame has a key of its own.

    Attributes:
        vectors: (N, P, W).
    """

    vectors: Tensor

    def match(self, asked: Tensor, rows: Tensor | None) -> Tensor:
        """See `Keys`."""
        return (asked if rows is None else asked[rows]) @ self.vectors.transpose(1, 2)

    def take(self, frames: Tensor) -> "OwnKeys":
        """See `Keys`."""
        return OwnKeys(self.vectors[frames])


class Slots(NamedTuple):
    """Where the R real ones of N x P parts are: frames of a batch have one to ten, and most have two.

    Attributes:
        frames: (R,) whose each part is.
        slots: (R,) which of its frame's it is.
        shape: N and P, the most that a frame has.
    """

    frames: Tensor
    slots: Tensor
    shape: tuple[int, int]

    @staticmethod
    def of(present: Tensor) -> "Slots":
        """Slots for the places (N, all places) that are parts, in their order."""
        frames, places = present.nonzero(as_tuple=True)
        slots = (present.cumsum(1) - 1)[frames, places]
        return Slots(frames, slots, (len(present), int(slots.max()) + 1 if len(slots) else 1))

    def pad(self, real: Tensor, empty: float = 0) -> Tensor:
        """(R, ...) to (N, P, ...)."""
        padded = real.new_full((*self.shape, *real.shape[1:]), empty)
        return padded.index_put((self.frames, self.slots), real)

    def take(self, frames: Tensor) -> "tuple[Slots, Tensor]":
        """Slots of some of the frames, whose numbers grow, and which of the R parts are theirs, (R,)."""
        number = self.frames.new_full((self.shape[0],), -1).index_put((frames,), torch.arange(len(frames)).to(frames))
        taken = number[self.frames] >= 0
        return Slots(number[self.frames[taken]], self.slots[taken], (len(frames), self.shape[1])), taken


class SharedKeys(NamedTuple):
    """A part's key is a sum of a table's rows. Questions are compared with the table, once for all of their frames.

    Attributes:
        table: (S, W).
        rows: (R, channels), the rows of each real part.
        slots: Where these parts are.
    """

    table: Tensor
    rows: Tensor
    slots: Slots

    def match(self, asked: Tensor, rows: Tensor | None) -> Tensor:
        """See `Keys`."""
        scores = (self.table @ asked.transpose(1, 2)).flatten(0, 1)  # (B * S, Q)
        whose = self.slots.frames if rows is None else rows[self.slots.frames]
        matches = F.embedding_bag(whose[:, None] * len(self.table) + self.rows, scores, mode="sum")
        return self.slots.pad(matches).transpose(1, 2)

    def take(self, frames: Tensor) -> "SharedKeys":
        """See `Keys`."""
        slots, taken = self.slots.take(frames)
        return SharedKeys(self.table, self.rows[taken], slots)


class Parts(NamedTuple):
    """Parts of N frames, such as cells of a grid or patches of a picture.

    Attributes:
        keys: What each part can be asked by; of several features, their parts one after another.
        values: (N, P, C) what it answers.
        bias: (N, P) how readily it answers whatever is asked; minus infinity where there is no part.
        places: (N, P) the number of each part among all of an observation's.
    """

    keys: tuple[Keys, ...]
    values: Tensor
    bias: Tensor
    places: Tensor

    @staticmethod
    def join(several: "list[Parts]") -> "Parts":
        """The parts of the same frames from several features."""
        keys, *others = zip(*several, strict=True)
        return Parts(sum(keys, ()), *(torch.cat(fields, dim=1) for fields in others))

    def match(self, asked: Tensor, rows: Tensor | None) -> Tensor:
        """How well the parts answer to questions, (N, Q, P); arguments as in `Keys.match`."""
        scores = [keys.match(asked, rows) for keys in self.keys]
        return torch.cat(scores, dim=-1) + self.bias[:, None]

    def take(self, frames: Tensor) -> "Parts":
        """Those of some of the frames, whose numbers grow."""
        keys = tuple(keys.take(frames) for keys in self.keys)
        return Parts(keys, self.values[frames], self.bias[frames], self.places[frames])


class Seen(NamedTuple):
    """N observations as the networks see them.

    Attributes:
        summary: (N, D) the whole of each.
        parts: Its parts; None if the encoder keeps none.
    """

    summary: Tensor
    parts: Parts | None

    def take(self, frames: Tensor | None) -> "Seen":
        """Some of the observations, whose numbers grow; None: all."""
        if frames is None:
            return self
        return Seen(self.summary[frames], None if self.parts is None else self.parts.take(frames))


class PartAttention(nn.Module):
    """Asks the parts of an observation: which of you is called so, and where are you?

    Each question is a vector in the space of words. It attends to the parts whose keys match it, or to nothing, and
    what they answer enters the observation's embedding together with what the question is about. BabyAI's own networks
    let the instruction modulate every cell by FiLM (arXiv:1810.08272); a product with names needs no example to know
    that "red ball" means the red ball.

    Args:
        asked: Width of the questions as they come.
        words: W, width of the space of words; questions of this width lie in it and are asked as they are at first, at
            the length of a whole phrase: else a skill that mixes all words, as it does before anything is learned,
            would be too weak to be answered, and nothing would ever be learned.
        values: C, width of the parts' answers.
        about: Width of what the questions are about.
        width: D.
        whole: Square of a whole phrase's length in units of W, see `WordEncoder.whole`.
        sharpness: Of the attention at first: the score of a match of 1.
    """

    def __init__(
        self,
        asked: int,
        words: int,
        values: int,
        about: int,
        width: int,
        whole: float = 2.0,
        sharpness: float = 8.0,
    ) -> None:
        super().__init__()
        self.length = (whole * words) ** 0.5
        self.as_they_are = asked == words
        self.question = nn.Linear(asked, words)
        self.nothing = nn.Linear(words, 1)
        if self.as_they_are:
            nn.init.zeros_(self.question.weight)
            nn.init.zeros_(self.question.bias)
        nn.init.zeros_(self.nothing.weight)
        nn.init.zeros_(self.nothing.bias)
        self.sharpness = nn.Parameter(torch.tensor(sharpness))
        self.answer, self.about = nn.Linear(values, values), nn.Linear(about, values)
        self.output = nn.Linear(values, width)

    def forward(
        self, parts: Parts, questions: Tensor, about: Tensor, valid: Tensor | None = None, rows: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """Ask the parts of N frames.

        Args:
            parts: Of the frames.
            questions: (B, Q, asked).
            about: (B, Q, about), what the questions are about.
            valid: (B, Q), False for questions that are none; None: all are.
            rows: (N,) whose questions each frame is asked; None: frame i is asked questions i.

        Returns:
            What the frames answer, (N, D), and where the questions looked, (N, Q, P); the rest went to nothing.
        """
        asked = self.question(questions) + (questions if self.as_they_are else 0)
        asked = F.normalize(asked, dim=-1) * (self.length * self.sharpness / asked.shape[-1])
        nothing, topic = self.nothing(asked), self.about(about)
        if valid is not None:
            topic = topic.masked_fill(~valid[..., None], 0)
        scores = parts.match(asked, rows)
        if rows is not None:
            nothing, topic = nothing[rows], topic[rows]
            valid = None if valid is None else valid[rows]
        looks = torch.cat([nothing, scores], dim=-1).softmax(-1)[..., 1:]
        if valid is not None:
            looks = looks.masked_fill(~valid[..., None], 0)
        heard = F.gelu(self.answer(looks @ parts.values) + topic) * looks.sum(-1, keepdim=True)
        return self.output(heard.sum(1)), looks


def answered(
    asks: PartAttention | None,
    seen: Seen,
    questions: Tensor,
    about: Tensor,
    valid: Tensor | None = None,
    rows: Tensor | None = None,
) -> tuple[Tensor, Tensor | None]:
    """What is seen, (N, D), with what its parts answer, and where questions looked; as it is if nothing can be asked.

    Arguments as in `PartAttention.forward`.
    """
    if asks is None or seen.parts is None:
        return seen.summary, None
    answers, looks = asks(seen.parts, questions, about, valid, rows)
    return seen.summary + answers, looks


def spread(parts: Parts | None, looks: Tensor | None, places: int) -> Tensor | None:
    """Attention (N, Q, P) summed over the questions and put where the parts are, (N, places); None without any."""
    if parts is None or looks is None:
        return None
    return looks.new_zeros(len(looks), places).scatter_add(1, parts.places, looks.sum(1))
