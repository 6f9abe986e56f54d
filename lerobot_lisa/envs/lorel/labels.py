"""What happened between two states, and the instruction that the data set's grammar makes of it."""

from typing import NamedTuple

import numpy as np

from lerobot_lisa.envs.lorel.state import BLACK_X, BLACK_Y, DRAWER, FAUCET, WHITE_X, WHITE_Y


class Event(NamedTuple):
    """A coordinate of the state grew (sign 1) or shrank (sign -1) by more than a threshold."""

    coordinate: int
    sign: int
    threshold: float

    def happened(self, before: np.ndarray, after: np.ndarray) -> bool:
        """Compare two states, (15,) each."""
        return bool(self.sign * (after[self.coordinate] - before[self.coordinate]) > self.threshold)


_MOVED, _TURNED = 0.02, np.pi / 10  # metres, radians

# In the picture of cam0 +x is left and +y is down.
EVENTS = {
    "move white mug down": Event(WHITE_Y, 1, _MOVED),
    "move white mug up": Event(WHITE_Y, -1, _MOVED),
    "move white mug left": Event(WHITE_X, 1, _MOVED),
    "move white mug right": Event(WHITE_X, -1, _MOVED),
    "move black mug down": Event(BLACK_Y, 1, _MOVED),
    "move black mug up": Event(BLACK_Y, -1, _MOVED),
    "move black mug left": Event(BLACK_X, 1, _MOVED),
    "move black mug right": Event(BLACK_X, -1, _MOVED),
    "close drawer": Event(DRAWER, 1, _MOVED),
    "open drawer": Event(DRAWER, -1, _MOVED),
    "turn faucet left": Event(FAUCET, 1, _TURNED),
    "turn faucet right": Event(FAUCET, -1, _TURNED),
}
"""Everything that a label of the LOReL data set can speak of (https://sites.google.com/view/robotlorel)."""

NOTHING = "do nothing"


def happened(before: np.ndarray, after: np.ndarray) -> tuple[str, ...]:
    """Names of the events between two states, in the order of `EVENTS`."""
    return tuple(name for name, event in EVENTS.items() if event.happened(before, after))


def describe(before: np.ndarray, after: np.ndarray, rng: np.random.Generator) -> str:
    """The instruction of an episode, by the templates that labelled the original data.

    Args:
        before: First state of the episode, (15,).
        after: State before its last action, (15,); the original compares with this one.
        rng: Puts the parts in order.

    Returns:
        Such as "close drawer and move black mug down and left", or "do nothing".
    """
    names = happened(before, after)
    mugs = [_mug_part(colour, names, rng) for colour in ("white", "black")]
    parts = [part for part in mugs if part] + [name for name in names if "mug" not in name]
    return " and ".join(_shuffled(parts, rng)) or NOTHING


def _mug_part(colour: str, names: tuple[str, ...], rng: np.random.Generator) -> str:
    prefix = f"move {colour} mug "
    directions = [name.removeprefix(prefix) for name in names if name.startswith(prefix)]
    return prefix + " and ".join(_shuffled(directions, rng)) if directions else ""


def _shuffled(words: list[str], rng: np.random.Generator) -> list[str]:
    return [words[i] for i in rng.permutation(len(words))]
