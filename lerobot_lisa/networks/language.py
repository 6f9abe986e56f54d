"""Language encoders: instruction tokens to one vector per token, word-level from scratch or any pretrained encoder."""

from collections import OrderedDict
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn.utils.rnn import pack_padded_sequence, pad_packed_sequence


class WordEncoder(nn.Module):
    """Word embeddings and a bidirectional GRU, trained from scratch: for template languages of tens of words."""

    def __init__(self, vocabulary_size: int, width: int) -> None:
        super().__init__()
        self.width = width
        self.embedding = nn.Embedding(vocabulary_size, width, padding_idx=0)
        self.gru = nn.GRU(width, width // 2, batch_first=True, bidirectional=True)

    def forward(self, tokens: Tensor, valid: Tensor) -> Tensor:
        """Tokens (B, M) and their validity (B, M), padding at the end -> (B, M, width). Padding changes nothing."""
        lengths = valid.sum(1).clamp(min=1).cpu()
        packed = pack_padded_sequence(self.embedding(tokens), lengths, batch_first=True, enforce_sorted=False)
        return pad_packed_sequence(self.gru(packed)[0], batch_first=True, total_length=tokens.shape[1])[0]


class PretrainedEncoder(nn.Module):
    """A Hugging Face encoder; frozen, it is asked once for each distinct instruction.

    Args:
        model: A `transformers` encoder with `config.hidden_size` and a `last_hidden_state` in its output.
        frozen: Keep its weights as they are and remember its answers.
        remembered: How many instructions' answers are kept.
    """

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

    def forward(self, tokens: Tensor, valid: Tensor) -> Tensor:
        """Tokens (B, M) and their validity (B, M) -> (B, M, width)."""
        unique, inverse = torch.unique(tokens.masked_fill(~valid, -1), dim=0, return_inverse=True)
        unique_valid = unique >= 0
        encode = self._remembered if self.frozen else self._encode
        return encode(unique.clamp(min=0), unique_valid)[inverse]

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

    Paper, section 4.1: every token is kept, nothing is pooled.
    """

    def __init__(self, encoder: WordEncoder | PretrainedEncoder, width: int) -> None:
        super().__init__()
        self.encoder = encoder
        self.output = nn.Linear(encoder.width, width)

    def forward(self, tokens: Tensor, valid: Tensor) -> Tensor:
        """Tokens (B, M) and their validity (B, M) -> (B, M, D)."""
        return self.output(self.encoder(tokens, valid))
