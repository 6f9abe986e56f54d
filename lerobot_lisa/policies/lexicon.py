"""Words that a policy knows things by: phrases of the training instructions, and what symbols are called."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from typing import Any

from lerobot_lisa.networks.symbols import SymbolNames

PHRASES = 1000  # the most frequent ones are kept, to read codes with
BABYAI_GRID = {
    "axes": ["column", "row", "channel"],
    "shape": [7, 7, 3],
    "naming": ["kind", "color"],
    "channels": [
        {
            "name": "kind",
            "words": ["unseen", "empty", "wall", "floor", "door", "key", "ball", "box", "goal", "lava", "agent"],
        },
        {"name": "color", "words": ["red", "green", "blue", "purple", "yellow", "grey"]},
        {"name": "state", "words": ["open", "closed", "locked"]},
    ],
}
"""What datasets of ours that were made before features had names for their symbols hold under `observation.grid`."""

Symbols = Mapping[str, Any]
"""`info["symbols"]` of a feature: its `shape`, channels last; for each channel its `name` and the `words` for 0, 1, and
so on; and `naming`, the channels that say what a thing is called (without it, all), what is there at all first."""


def symbols_of(key: str, shape: Sequence[int], info: Mapping[str, Any]) -> Symbols | None:
    """What the symbols of a feature are called, if anybody says so."""
    if "symbols" in info:
        symbols: Symbols = info["symbols"]
        return symbols if len(symbols["channels"]) > 1 else None  # a lone symbol, such as a heading, is no thing
    return BABYAI_GRID if key == "observation.grid" and tuple(shape) == (147,) else None


def symbol_words(symbols: Symbols) -> list[str]:
    """All words that name things."""
    return [word for channel in symbols["channels"] if _names(symbols, channel) for word in channel["words"]]


def symbol_names(symbols: Symbols, lexicon: Sequence[str]) -> SymbolNames:
    """The same by numbers of the words in the lexicon; symbols whose words were never said have none."""
    numbers = {word: number for number, word in enumerate(lexicon)}
    return SymbolNames(
        tuple(
            tuple(numbers.get(word, -1) if _names(symbols, channel) else -1 for word in channel["words"])
            for channel in symbols["channels"]
        )
    )


def _names(symbols: Symbols, channel: Mapping[str, Any]) -> bool:
    return channel["name"] in symbols.get("naming", [channel["name"]])


def said_phrases(instructions: Iterable[Sequence[str]], names: Iterable[str]) -> list[str]:
    """Names of things that were spoken of, then the most frequent phrases of one or two words.

    Args:
        instructions: Each as its words.
        names: What symbols are called.
    """
    listed = [list(words) for words in instructions]
    said = {word for words in listed for word in words}
    things = [name for name in dict.fromkeys(names) if name in said]
    counts = Counter(
        phrase for words in listed for phrase in (words[0:1] + [" ".join(pair) for pair in pairwise(words)])
    )
    phrases = [phrase for phrase, _ in sorted(counts.items(), key=lambda item: (-item[1], item[0]))[:PHRASES]]
    return [*things, *(phrase for phrase in phrases if phrase not in things)]
