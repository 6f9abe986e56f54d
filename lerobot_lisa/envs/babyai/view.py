"""The agent's 7x7 partial view by table lookup: the same bytes as minigrid's `gen_obs()["image"]`, much faster."""

from functools import lru_cache
from operator import itemgetter
from typing import NamedTuple

import numpy as np
from minigrid.core.constants import DIR_TO_VEC, OBJECT_TO_IDX
from minigrid.core.world_object import Wall
from minigrid.minigrid_env import MiniGridEnv

SIDE = 7
"""Cells along each side of the view, in every BabyAI level."""

_AGENT = SIDE // 2  # the agent's column, and its cell number: rows are counted away from the agent
_EMPTY = OBJECT_TO_IDX["empty"]
_ROW = (1 << SIDE) - 1  # one bit per column of a row of the view
_OUTSIDE = Wall()  # what minigrid shows beyond the edge of the world


class View(NamedTuple):
    """What the agent sees.

    Attributes:
        image: uint8 (7, 7, 3), column, row, (object, color, state); the agent is at [3, 6] and looks towards row 0.
        visible: The world cells that are seen, as indices `y * width + x` into `env.grid.grid`.
    """

    image: np.ndarray
    visible: list[int]


class _Pose(NamedTuple):
    """The 49 world cells in front of one position and direction, nearest row first."""

    gather: itemgetter
    cells: tuple[int, ...]


def partial_view(env: MiniGridEnv) -> View:
    """Look at the world of `env` as it is now.

    Args:
        env: A level with a view of 7x7 cells and walls that block sight, as all BabyAI levels have.

    Returns:
        The view, equal to minigrid's `gen_obs()["image"]`, and the world cells that it shows.
    """
    grid = env.grid
    pose = _pose(grid.width, grid.height, *env.agent_pos, env.agent_dir)
    cells = pose.gather([*grid.grid, _OUTSIDE])
    seen = _seen(cells)
    image = bytearray(SIDE * SIDE * 3)
    for number in seen:
        cell, byte = cells[number], _BYTE[number]
        if cell is None:
            image[byte] = _EMPTY
        else:
            image[byte : byte + 3] = cell.encode()
    # The agent does not see the cell it stands on but what it carries.
    carried = env.carrying.encode() if env.carrying else (_EMPTY, 0, 0)
    image[_BYTE[_AGENT] : _BYTE[_AGENT] + 3] = bytes(carried)
    world, outside = pose.cells, len(grid.grid)
    visible = [world[number] for number in seen if world[number] != outside]
    return View(np.frombuffer(image, np.uint8).reshape(SIDE, SIDE, 3), visible)


def _seen(cells: tuple) -> list[int]:
    """Number the cells in sight: light spreads within a row and to the row beyond, but not past opaque cells."""
    clear = (1 << SIDE * SIDE) - 1
    for number, cell in enumerate(cells):
        if cell is not None and not cell.see_behind():
            clear ^= 1 << number
    seen: list[int] = []
    lit = 1 << _AGENT
    for numbers in _NUMBERS:
        row, lit = _SPREAD[lit, clear & _ROW]
        seen += numbers[row]
        clear >>= SIDE
    return seen


@lru_cache(maxsize=1 << 14)
def _pose(width: int, height: int, x: int, y: int, direction: int) -> _Pose:
    """Find the world cells of the view; those beyond the edge get the number after the last cell."""
    ahead_x, ahead_y = (int(part) for part in DIR_TO_VEC[direction])
    cells = []
    for row in range(SIDE):
        for column in range(-_AGENT, SIDE - _AGENT):
            i = x + ahead_x * row - ahead_y * column
            j = y + ahead_y * row + ahead_x * column
            inside = 0 <= i < width and 0 <= j < height
            cells.append(int(j * width + i) if inside else width * height)
    return _Pose(itemgetter(*cells), tuple(cells))


def _spread_light(lit: int, clear: int) -> tuple[int, int]:
    """Follow `Grid.process_vis` through one row: lit columns and clear columns -> lit columns here, and in the next."""
    beyond = 0
    sweeps = ((range(SIDE - 1), 1), (range(SIDE - 1, 0, -1), -1))
    for columns, step in sweeps:
        for column in columns:
            if lit & clear & (1 << column):
                lit |= 1 << column + step
                beyond |= 1 << column + step | 1 << column
    return lit, beyond


_SPREAD = {(lit, clear): _spread_light(lit, clear) for lit in range(_ROW + 1) for clear in range(_ROW + 1)}
# Per row of the view and set of lit columns: the numbers of the lit cells.
_NUMBERS = [
    [[row * SIDE + column for column in range(SIDE) if lit & 1 << column] for lit in range(_ROW + 1)]
    for row in range(SIDE)
]
# Where each cell lies in the image: C order of (column, row, channel), and the agent's row is the last.
_BYTE = [(column * SIDE + SIDE - 1 - row) * 3 for row in range(SIDE) for column in range(SIDE)]
