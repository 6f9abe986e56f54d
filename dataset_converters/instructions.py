"""What may be an instruction: one line of visible text, in any script."""

import unicodedata
from typing import Any

from lerobot_lisa.errors import UserError

_LONGEST = 1000  # characters; BabyAI's longest instruction has 183
_INVISIBLE = {"Cc", "Cs", "Zl", "Zp"}  # control characters, halves of characters, ends of lines and paragraphs
_REORDERING = {"LRE", "RLE", "LRO", "RLO", "PDF", "LRI", "RLI", "FSI", "PDI"}  # make text look other than it is


def check_instruction(text: Any, what: str = "the task") -> None:
    """Raise `UserError`, beginning with `what`, for anything but one line of visible text."""
    if not isinstance(text, str) or not any(c.isprintable() and not c.isspace() for c in text):
        raise UserError(f"{what} is {repr(text)[:80]}; give a non-empty instruction")
    if len(text) > _LONGEST:
        raise UserError(f"{what} has {len(text):,} characters ({text[:40]!r}...); give at most {_LONGEST:,}")
    if any(unicodedata.category(c) in _INVISIBLE or unicodedata.bidirectional(c) in _REORDERING for c in text):
        raise UserError(f"{what} is {text[:80]!r}; give one line of text without control characters")
