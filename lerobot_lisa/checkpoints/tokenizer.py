"""The tokenizer that a checkpoint's preprocessor carries: what it may do to an instruction.

Tokenizers are read by a library that runs no code of theirs, but its JSON can ask for a text to be blown up, padded to
any length, or for ids that the language encoder does not have.
"""

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tokenizers import Tokenizer

from lerobot_lisa.checkpoints.files import RETAKE, refusing
from lerobot_lisa.errors import UserError

_GROWTH = 1000  # times that a text may become longer; real ones stay below 20
_SAMPLE = "go to the red ball, then open a door ☃"


def check_tokenizer(path: Path, content: bytes, ids: int) -> None:
    """Refuse a tokenizer that cannot be used.

    Args:
        path: Its file, for messages.
        content: Its JSON.
        ids: How many ids the language encoder knows.

    Raises:
        UserError: It cannot be used.
    """
    with refusing(f"{path} holds no tokenizer"):
        written = json.loads(content)
        if written.get("padding"):
            raise ValueError("it pads")
        if (growth := math.prod(_growths(written.get("normalizer")))) > _GROWTH:
            raise ValueError(f"it makes a text {growth} times as long")
        tokens = _tried(content)
    if tokens and max(tokens) >= ids:
        raise UserError(f"{path} gives the id {max(tokens)}, but the language encoder knows {ids}: {RETAKE}")


def _tried(content: bytes) -> list[int]:
    """All ids of a tokenizer's vocabulary, and those it gives a sample."""
    try:
        tokenizer = Tokenizer.from_str(content.decode())
        return [*tokenizer.get_vocab().values(), *tokenizer.encode(_SAMPLE).ids]
    except (KeyboardInterrupt, SystemExit):
        raise
    except BaseException as error:  # the library's panics are no Exception
        raise ValueError(str(error)) from error


def _growths(normalizer: Any) -> Iterator[int]:
    """By how much each replacement of a normaliser may lengthen a text."""
    if isinstance(normalizer, dict):
        if isinstance(normalizer.get("content"), str):
            yield 1 + len(normalizer["content"])  # an empty match adds it to what is there
        yield from _growths(normalizer.get("normalizers"))
    elif isinstance(normalizer, list):
        for part in normalizer:
            yield from _growths(part)
