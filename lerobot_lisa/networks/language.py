"""Language encoders: instructions to one vector per token, to phrases, and names of things to vectors beside them."""

from collections import OrderedDict
from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torch.nn.utils.rnn import pack_padded_sequence, pad_packed_sequence


class Instruction(NamedTuple):
    """B encoded instructions.

    Attributes:
        tokens: (B, M, D), each token in its context, at the model's width.
        valid: (B, M), False for padding.
        phrases: (B, M, W), each token with what it belongs to, in the space of words: where names of things lie, too.
        names: (B, M), which tokens are words that name things; all of them where nothing has a name.
        ends: (B, M), which of them are the last of their name, "ball" of "red ball": whose phrases are whole names; all
            tokens of instructions that name nothing.
    """

    tokens: Tensor
    valid: Tensor
    phrases: Tensor
    names: Tensor
    ends: Tensor

    def naming(self) -> "Instruction":
        """Only the tokens that name things, in order: what else is said finds nothing among things with names."""
        most = max(1, int(self.names.sum(1).max()))
        order = (~self.names).to(torch.uint8).argsort(dim=1, stable=True)[:, :most]
        rows = torch.arange(len(order), device=order.device)[:, None]
        valid = self.names[rows, order]
        ends = self.ends[rows, order] & valid
        return Instruction(self.tokens[rows, order], valid, self.phrases[rows, order], valid, ends)

    def sentence(self) -> Tensor:
        """The whole of each instruction as one vector (B, D): the mean of its tokens in their context."""
        return mean_token(self.tokens, self.valid)

    def take(self, rows: Tensor) -> "Instruction":
        """The instructions of some rows (N,), repeats allowed."""
        return Instruction(*(part[rows] for part in self))


def mean_token(tokens: Tensor, valid: Tensor) -> Tensor:
    """Of the tokens (B, M, D) that are real, (B, D)."""
    return (tokens * valid[..., None]).sum(1) / valid.sum(1, keepdim=True)


class WordEncoder(nn.Module):
    """Word embeddings and a bidirectional GRU, trained from scratch: for template languages of tens of words.

    A phrase is a token's embedding plus its predecessor's, and so is the name of a thing the sum of its words: "red
    ball" said and a red ball seen are the same vector from the first step on.
    """

    whole = 2.0
    """Products of two equal phrases, in units of the width; of two that share one of two words, half of it."""

    def __init__(self, vocabulary_size: int, width: int) -> None:
        super().__init__()
        self.width = width
        self.embedding = nn.Embedding(vocabulary_size, width, padding_idx=0)
        self.gru = nn.GRU(width, width // 2, batch_first=True, bidirectional=True)

    def forward(self, tokens: Tensor, valid: Tensor) -> tuple[Tensor, Tensor]:
        """Tokens (B, M) and their validity (B, M), padding at the end -> tokens in context and phrases, (B, M, W)."""
        embedded = self.embedding(tokens)
        lengths = valid.sum(1).clamp(min=1).cpu()
        packed = pack_padded_sequence(embedded, lengths, batch_first=True, enforce_sorted=False)
        context = pad_packed_sequence(self.gru(packed)[0], batch_first=True, total_length=tokens.shape[1])[0]
        return context, embedded + F.pad(embedded, (0, 0, 1, 0))[:, :-1]

    def names(self, tokens: Tensor, valid: Tensor) -> Tensor:
        """Names of things as tokens (n, L) -> (n, W)."""
        return (self.embedding(tokens) * valid[..., None]).sum(1)


class PretrainedEncoder(nn.Module):
    """A Hugging Face encoder; frozen, it is asked once for each distinct instruction.

    Args:
        model: A `transformers` encoder with `config.hidden_size` and a `last_hidden_state` in its output.
        frozen: Keep its weights as they are and remember its answers.
        remembered: How many instructions' answers are kept.
    """

    whole = 1.0

    def __init__(self, model: Any, frozen: bool, remembered: int = 20_000) -> None:
        super().__init__()
        self.model, self.frozen, self.remembered = model, frozen, remembered
        self.width: int = model.config.hidden_size
        self._answers: OrderedDict[tuple[int, ...], Tensor] = OrderedDict()
        if frozen:
            model.requires_grad_(False).eval()

    def train(self, mode: bool = True) -> "PretrainedEncoder":
        """A frozen encoder stays in evaluation mode: dropout would make its answers differ each time."""
        super().train(mode)
        if self.frozen:
            self.model.eval()
        return self

    def forward(self, tokens: Tensor, valid: Tensor) -> tuple[Tensor, Tensor]:
        """Tokens (B, M) and their validity (B, M) -> hidden states, and these at unit scale as phrases, (B, M, W)."""
        unique, inverse = torch.unique(tokens.masked_fill(~valid, -1), dim=0, return_inverse=True)
        unique_valid = unique >= 0
        encode = self._remembered if self.frozen else self._encode
        hidden = encode(unique.clamp(min=0), unique_valid)[inverse]
        return hidden, F.layer_norm(hidden, hidden.shape[-1:])

    def names(self, tokens: Tensor, valid: Tensor) -> Tensor:
        """Names of things as tokens (n, L) -> the mean of their phrases, (n, W)."""
        phrases = self(tokens, valid)[1] * valid[..., None]
        return phrases.sum(1) / valid.sum(1, keepdim=True).clamp(min=1)

    def _encode(self, tokens: Tensor, valid: Tensor) -> Tensor:
        return self.model(input_ids=tokens, attention_mask=valid.long()).last_hidden_state

    @torch.no_grad()
    def _remembered(self, tokens: Tensor, valid: Tensor) -> Tensor:
        keys = [tuple(row[: int(n)]) for row, n in zip(tokens.tolist(), valid.sum(1), strict=True)]
        for row, key in enumerate(keys):
            if key not in self._answers:  # asked alone, so that company and padding do not move the last digit
                alone = slice(row, row + 1), slice(len(key))
                self._answers[key] = self._encode(tokens[alone], valid[alone])[0]
        answers = tokens.new_zeros((*tokens.shape, self.width), dtype=self._answers[keys[0]].dtype)
        for row, key in enumerate(keys):
            self._answers.move_to_end(key)
            answers[row, : len(key)] = self._answers[key]
        while len(self._answers) > self.remembered:
            self._answers.popitem(last=False)
        return answers


class LanguageEncoder(nn.Module):
    """An encoder of instructions and the linear layer that brings every word token to the model's width.

    Paper, section 4.1: every token is kept, nothing is pooled. Names of things are encoded beside the instructions, so
    that what is seen and what is said can be compared.

    Args:
        encoder: Tokens to vectors of its own width W.
        width: D.
        names: Token ids of the names of things, in the order in which `ObservationSpec.names` counts them.
    """

    name_tokens: Tensor
    name_valid: Tensor

    def __init__(
        self, encoder: WordEncoder | PretrainedEncoder, width: int, names: Sequence[Sequence[int]] = ()
    ) -> None:
        super().__init__()
        self.encoder = encoder
        self.output = nn.Linear(encoder.width, width)
        tokens, valid = pad_tokens(names)
        self.register_buffer("name_tokens", tokens, persistent=False)
        self.register_buffer("name_valid", valid, persistent=False)

    def forward(self, tokens: Tensor, valid: Tensor) -> Instruction:
        """Encode token ids (B, M), with their validity (B, M)."""
        context, phrases = self.encoder(tokens, valid)
        if not len(self.name_tokens):
            return Instruction(self.output(context), valid, phrases, valid, valid)
        names = torch.isin(tokens, self.name_tokens[self.name_valid]) & valid
        ends = names & ~F.pad(names[:, 1:], (0, 1))
        ends = torch.where(ends.any(1, keepdim=True), ends, valid)
        return Instruction(self.output(context), valid, phrases, names, ends)

    def names(self) -> Tensor:
        """Vectors of all names of things, (n, W), beside the phrases of instructions."""
        if not len(self.name_tokens):
            return self.output.weight.new_zeros(0, self.encoder.width)
        return self.encoder.names(self.name_tokens, self.name_valid)

    def encode_names(self, names: Sequence[Sequence[int]]) -> Tensor:
        """Vectors of other names, or phrases, given by their token ids, (n, W)."""
        tokens, valid = (part.to(self.output.weight.device) for part in pad_tokens(names))
        return self.encoder.names(tokens, valid)


def pad_tokens(rows: Sequence[Sequence[int]]) -> tuple[Tensor, Tensor]:
    """Token ids of different lengths as (n, L), zeros at the end, and their validity."""
    longest = max((len(row) for row in rows), default=0)
    tokens = torch.tensor([[*row, *[0] * (longest - len(row))] for row in rows], dtype=torch.int64)
    lengths = torch.tensor([len(row) for row in rows], dtype=torch.int64)
    return tokens.view(len(rows), longest), torch.arange(longest) < lengths[:, None]
