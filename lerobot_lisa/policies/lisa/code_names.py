"""Skill codes by words: what a code is called, and which code a name means."""

from collections.abc import Mapping
from difflib import get_close_matches

import torch
import torch.nn.functional as F
from torch import Tensor

from lerobot_lisa.errors import UserError
from lerobot_lisa.networks.lisa import Lisa

MOST_LABELS = 10_000  # codes; more have no labels


@torch.no_grad()
def code_labels(network: Lisa, lexicon: Mapping[str, list[int]]) -> list[str] | None:
    """Number and nearest phrase of each code, " / " between its parts; None if there are too many codes.

    Args:
        network: Whose codes lie among words.
        lexicon: Phrases and their token ids.
    """
    if network.quantizer.n_codes > MOST_LABELS:
        return None
    phrases = network.language.encode_names(list(lexicon.values()))
    nearest = (F.normalize(_codes(network), dim=-1) @ F.normalize(phrases, dim=-1).T).argmax(-1)
    names = list(lexicon)
    return [f"{code} {' / '.join(names[i] for i in row)}" for code, row in enumerate(nearest.tolist())]


@torch.no_grad()
def find_code(network: Lisa, lexicon: Mapping[str, list[int]], text: str) -> int:
    """The code that is nearest to what a name says, such as "red ball", or "pick up / red ball" for two parts.

    Raises:
        UserError: Some of it is no phrase of the lexicon, or it names another number of parts than a code has.
    """
    codes, wanted = _codes(network), network.language.encode_names([lexicon[name] for name in split(lexicon, text)])
    if len(wanted) != codes.shape[1]:
        raise UserError(f"{text!r:.60} names {len(wanted)} parts, but a code has {codes.shape[1]}: put / between them")
    return int((codes - wanted).square().sum((1, 2)).argmin())


def split(lexicon: Mapping[str, list[int]], text: str) -> list[str]:
    """The phrases of a name.

    Raises:
        UserError: One of them is not in the lexicon.
    """
    phrases = [part.strip() for part in text.split("/")]
    if unknown := [phrase for phrase in phrases if phrase not in lexicon]:
        close = get_close_matches(unknown[0], lexicon, n=3)
        hint = f"did you mean {' or '.join(map(repr, close))}?" if close else "its instructions never said that"
        raise UserError(f"{unknown[0]!r:.60} is no phrase that this policy knows: {hint}")
    return phrases


def _codes(network: Lisa) -> Tensor:
    """All codes (K, parts, W)."""
    return network.quantizer.embed(
        torch.arange(network.quantizer.n_codes, device=network.skill_embedding.weight.device)
    )
