"""Frames of the whole world for videos, put together from minigrid's own tiles; drawing each tile only once."""

import numpy as np
from minigrid.core.grid import Grid
from minigrid.core.world_object import WorldObj
from minigrid.minigrid_env import MiniGridEnv

from lerobot_lisa.envs.babyai.view import partial_view
from lerobot_lisa.errors import UserError

_Look = tuple[tuple[int, int, int] | None, int | None, bool]  # cell encoding, direction of an agent there, lit


def default_tile_size(cells: int) -> int:
    """Pixels for each cell of a world that is `cells` wide: LeRobot keeps every frame of ten episodes in memory."""
    return 16 if cells <= 11 else 8


class Renderer:
    """Draws worlds with square tiles of one size.

    Attributes:
        tile_size: Pixels along each side of a tile; even, since video codecs want frames with even sides.
    """

    def __init__(self, tile_size: int) -> None:
        if not isinstance(tile_size, int) or tile_size < 2 or tile_size % 2:
            raise UserError(f"tile_size is {tile_size!r}: choose an even number of pixels from 2 up, such as 16")
        self.tile_size = tile_size
        self._numbers: dict[_Look, int] = {}
        # Rows of pixels of all tiles, one tile after the other: frames are gathered row by row, in the order of memory.
        self._pixels = np.zeros((0, tile_size * 3), np.uint8)

    def frame(self, level: MiniGridEnv) -> np.ndarray:
        """Draw the world of `level` as minigrid does: objects, the agent's arrow, and what it sees highlighted.

        Returns:
            uint8 (height * tile_size, width * tile_size, 3), red, green, blue.
        """
        grid, side = level.grid, self.tile_size
        lit = [False] * len(grid.grid)
        for number in partial_view(level).visible:
            lit[number] = True
        tiles = [self._tile(cell, None, light) for cell, light in zip(grid.grid, lit, strict=True)]
        agent = int(level.agent_pos[1] * grid.width + level.agent_pos[0])
        tiles[agent] = self._tile(grid.grid[agent], level.agent_dir, lit[agent])
        rows = np.reshape(tiles, (grid.height, 1, grid.width)) * side + np.arange(side)[:, None]
        return np.take(self._pixels, rows, axis=0).reshape(grid.height * side, grid.width * side, 3)

    def _tile(self, cell: WorldObj | None, direction: int | None, light: bool) -> int:
        """Number the tile that looks so, drawing it at the first need."""
        look = (cell.encode() if cell else None, direction, light)
        number = self._numbers.get(look)
        if number is None:
            tile = Grid.render_tile(cell, direction, light, self.tile_size)
            number = self._numbers[look] = len(self._numbers)
            self._pixels = np.concatenate([self._pixels, tile.astype(np.uint8).reshape(self.tile_size, -1)])
        return number
