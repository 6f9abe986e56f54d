"""Skill codes by words: what a code is called, and which code a name means."""

import re
from collections.abc import Mapping
from difflib import get_close_matches

import torch
import torch.nn.functional as F
from torch import Tensor

from lerobot_lisa.errors import UserError
from lerobot_lisa.networks.copying import PhraseCopier
from lerobot_lisa.networks.lisa import Lisa

MOST_LABELS = 10_000  # codes; more have no labels
MADE_UP = re.compile(r"#\d{1,6}")


@torch.no_grad()
def code_labels(network: Lisa, lexicon: Mapping[str, list[int]]) -> list[str] | None:
    """Number and what each part is called, " / " between them; None if there are too many codes.

    A copied part is called like its nearest phrase; one that the skill predictor has made up has a number, "#3".

    Args:
        network: Whose codes lie among words.
        lexicon: Phrases and their token ids.
    """
    if network.quantizer.n_codes > MOST_LABELS:
        return None
    phrases = F.normalize(network.language.encode_names(list(lexicon.values())), dim=-1)
    copied, own = _codes(network)
    nearest = (F.normalize(copied, dim=-1) @ phrases.T).argmax(-1).tolist()
    names = list(lexicon)
    parts = ([*(names[i] for i in row), *(f"#{n}" for n in more)] for row, more in zip(nearest, own, strict=True))
    return [f"{code} {' / '.join(row)}" for code, row in enumerate(parts)]


@torch.no_grad()
def find_code(network: Lisa, lexicon: Mapping[str, list[int]], text: str) -> int:
    """The code that is nearest to what a name says, such as "red ball", or "pick up / red ball" for two parts.

    Parts that the skill predictor makes up are named by number, "red ball / #3"; left out, they are the ones that were
    used most in training.

    Raises:
        UserError: Some of it is no phrase of the lexicon, or it names another number of parts than a code has.
    """
    phrases, numbers = split(lexicon, text)
    copied, own = _codes(network)
    if len(phrases) != copied.shape[1] or len(numbers) not in (0, own.shape[1]):
        count = f"{copied.shape[1]} parts" + (f", and {own.shape[1]} with a number (#0)" if own.shape[1] else "")
        raise UserError(
            f"{text!r:.60} names {len(phrases) + len(numbers)} parts, but a code has {count}: put / between them"
        )
    wanted = network.language.encode_names([lexicon[name] for name in phrases])
    distances = (copied - wanted).square().sum((1, 2))
    if own.shape[1]:
        chosen = torch.tensor(numbers or network.quantizer.most_used[-own.shape[1] :], device=own.device)
        distances = distances.masked_fill((own != chosen).any(1), float("inf"))
    if torch.isinf(distances).all():
        raise UserError(f"{text!r:.60}: parts with a number are #0 to #{int(own.max())}")
    return int(distances.argmin())


def split(lexicon: Mapping[str, list[int]], text: str) -> tuple[list[str], list[int]]:
    """The phrases of a name, and the numbers of its made-up parts.

    Raises:
        UserError: One of them is not in the lexicon.
    """
    parts = [part.strip() for part in text.split("/")]
    numbers = [int(part[1:]) for part in parts if MADE_UP.fullmatch(part)]
    phrases = [part for part in parts if not MADE_UP.fullmatch(part)]
    if unknown := [phrase for phrase in phrases if phrase not in lexicon]:
        close = get_close_matches(unknown[0], lexicon, n=3)
        hint = f"did you mean {' or '.join(map(repr, close))}?" if close else "its instructions never said that"
        raise UserError(f"{unknown[0]!r:.60} is no phrase that this policy knows: {hint}")
    return phrases, numbers


def _codes(network: Lisa) -> tuple[Tensor, Tensor]:
    """Of all K codes the parts that are copied (K, copied, W), and the numbers of those that are made up (K, own)."""
    everything = torch.arange(network.quantizer.n_codes, device=network.skill_embedding.weight.device)
    own = len(network.source.own) if isinstance(network.source, PhraseCopier) else 0
    embeddings = network.quantizer.embed(everything)
    copied = embeddings.shape[1] - own
    return embeddings[:, :copied], network.quantizer.split(everything)[:, copied:] if own else everything[:, None][
        :, :0
    ]
