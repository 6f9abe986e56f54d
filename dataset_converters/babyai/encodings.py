"""The encodings of grid cells in gym-minigrid's history, and the way from each to minigrid's.

Old files do not say which one they use. All are uint8 (object, color, state) per cell:

====================  ===========================================================  ============================
until                 object                                                       state
====================  ===========================================================  ============================
November 2018 (A)     empty 0, wall 1, door 3, locked door 4, key 5, ball 6, box 7  1 open
January 2019 (B)      unseen 0, empty 1, wall 2, door 4, locked door 5, key 6,      1 open
                      ball 7, box 8
today (minigrid)      unseen 0, empty 1, wall 2, door 4, key 5, ball 6, box 7       0 open, 1 closed, 2 locked
====================  ===========================================================  ============================
"""

from collections.abc import Iterable
from enum import StrEnum

import numpy as np

from lerobot_lisa.errors import UserError

_EMPTY, _WALL, _DOOR, _GREY = 1, 2, 4, 5  # minigrid's numbers; B agrees on the first three
_KEY = _LOCKED_DOOR_B = 5
_BOX_B = 8
_LOCKED = 2
_MOST = np.array([7, 5, 2])  # largest object, color and state in minigrid's partial view of a BabyAI level


class CellEncoding(StrEnum):
    """How a file encodes the cells of the grid."""

    A = "a"
    B = "b"
    MINIGRID = "minigrid"


def signs(images: np.ndarray) -> set[CellEncoding]:
    """Encodings that one episode proves.

    An object 5 is a key today and was a locked door in B. A door has walls on two sides, so an object 5 with empty
    cells beside and before it is a key.

    Args:
        images: uint8 (T, 7, 7, 3).
    """
    found = set()
    objects, colors, states = images[..., 0], images[..., 1], images[..., 2]
    if ((objects == 1) & (colors == _GREY)).any():
        found.add(CellEncoding.A)
    if (objects == _BOX_B).any() or ((objects == _LOCKED_DOOR_B) & (states == 1)).any():
        found.add(CellEncoding.B)
    if ((objects == _DOOR) & (states == _LOCKED)).any() or _away_from_walls(objects, _KEY):
        found.add(CellEncoding.MINIGRID)
    return found


def _away_from_walls(objects: np.ndarray, kind: int) -> bool:
    """Whether somewhere an object of `kind` has an empty neighbour along both axes."""
    empty = np.pad(objects == _EMPTY, ((0, 0), (1, 1), (1, 1)))
    along = empty[:, :-2, 1:-1] | empty[:, 2:, 1:-1]
    across = empty[:, 1:-1, :-2] | empty[:, 1:-1, 2:]
    return bool(((objects == kind) & along & across).any())


def detect(episodes: Iterable[np.ndarray]) -> CellEncoding:
    """Find the encoding that a sample of episodes is in.

    Args:
        episodes: each uint8 (T, 7, 7, 3).

    Raises:
        UserError: if they prove two encodings, or none.
    """
    found: set[CellEncoding] = set()
    for images in episodes:
        found |= signs(images)
        if CellEncoding.A in found or len(found) > 1:
            break
    if CellEncoding.A in found:
        return CellEncoding.A
    if len(found) > 1:
        raise UserError("its episodes are in different cell encodings; convert the files that it was joined from")
    if not found:
        raise UserError(
            "its cells fit both minigrid's encoding and the one used before January 2019; if you know which, say "
            "--cell-encoding minigrid or --cell-encoding b"
        )
    return found.pop()


def to_minigrid(images: np.ndarray, encoding: CellEncoding) -> np.ndarray:
    """Rewrite cells as minigrid encodes them; (T, 7, 7, 3) uint8 in and out.

    Raises:
        UserError: for encoding A, which does not tell unseen from empty cells, or for cells that do not exist.
    """
    if encoding is CellEncoding.A:
        raise UserError(
            "its cells are in the encoding from before November 2018, which does not tell unseen from empty cells; "
            "use the second version of the demonstrations (demos_iclr19_v2) or generate new ones"
        )
    if encoding is CellEncoding.B:
        images = _from_b(images)
    if (images.reshape(-1, 3).max(axis=0) > _MOST).any():
        raise UserError(f"it has cells that do not exist in the cell encoding '{encoding.value}'")
    return images


def _from_b(images: np.ndarray) -> np.ndarray:
    objects, states = images[..., 0], images[..., 2]
    if objects.max() > _BOX_B or states.max() > 1:
        raise UserError("it has cells that do not exist in the cell encoding 'b'")
    rewritten = images.copy()
    rewritten[..., 0] = _OBJECT_FROM_B[objects]
    rewritten[..., 2] = _STATE_FROM_B[objects, states]
    return rewritten


_OBJECT_FROM_B = np.array([0, 1, 2, 3, 4, 4, 5, 6, 7], np.uint8)
_STATE_FROM_B = np.zeros((9, 2), np.uint8)  # [object in B, open in B]
_STATE_FROM_B[4] = (1, 0)  # a door: closed, open
_STATE_FROM_B[5] = (_LOCKED, 0)  # a locked door: locked, open
