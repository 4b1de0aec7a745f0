"""A map as a rectangle of cells that stays in its tiles, and is unfolded a few rows at a time."""

from __future__ import annotations

from typing import TYPE_CHECKING, final

import numpy as np

from gridslam.grid.evidence import LOG_ODDS_UNIT
from gridslam.grid.frame import cell_corner
from gridslam.kernels import TILE, UNKNOWN
from gridslam.types import OccupancyGrid

if TYPE_CHECKING:
    from gridslam.grid.tiles import TileMaps

__all__ = ["TiledGrid"]


@final
class TiledGrid:
    """One map of `TileMaps`, cut to the tiles that hold something; a single unknown cell if there are none.

    What is written to the map later does not change it. Tiles take 3 bytes a cell, and only where something is known;
    unfolded as an `OccupancyGrid` the whole rectangle takes 5: 210 MB for 460 m x 230 m in cells of 5 cm.

    Attributes
    ----------
    shape : (int, int)
        Rows and columns of cells.
    resolution_m : float
        Side of a cell.
    origin : (float, float), m
        World coordinates of the lower left corner of cell [0, 0].
    """

    __slots__ = ("_corner", "_cut", "_maps", "origin", "resolution_m", "shape")

    def __init__(self, maps: TileMaps, row: int) -> None:
        """Take map `row` as it is now."""
        self._maps = maps.snapshot(np.array([row]))
        ids, first = maps.tile_ids(row)
        tile_rows, tile_columns = np.nonzero(ids)
        if len(tile_rows):
            (top, left), (bottom, right) = (
                (int(side(tile_rows)), int(side(tile_columns))) for side in (np.min, np.max)
            )
            self._cut = slice(top, bottom + 1), slice(left, right + 1)
            self._corner = (first[0] + top) * TILE, (first[1] + left) * TILE
            self.shape = (bottom + 1 - top) * TILE, (right + 1 - left) * TILE
        else:
            self._cut, self._corner, self.shape = (slice(1), slice(1)), (0, 0), (1, 1)
        self.resolution_m = maps.resolution_m
        self.origin = cell_corner(*self._corner, maps.resolution_m)

    def rows(self, first: int, last: int) -> OccupancyGrid:
        """Unfold rows `first` to `last` - 1."""
        width = self.shape[1]
        log_odds, known = np.empty((last - first, width), np.float32), np.empty((last - first, width), np.bool_)
        ids = self._maps.tile_ids(0)[0][self._cut]
        for tile_row in range(first // TILE, -(-last // TILE)):
            strip = self._maps.tiles(ids[tile_row]).swapaxes(0, 1).reshape(TILE, -1)[:, :width]
            begin, end = max(first, tile_row * TILE), min(last, (tile_row + 1) * TILE)
            cells, to = strip[begin - tile_row * TILE : end - tile_row * TILE], slice(begin - first, end - first)
            np.not_equal(cells, UNKNOWN, out=known[to])
            log_odds[to] = np.where(known[to], cells, 0)
        log_odds *= LOG_ODDS_UNIT
        row, column = self._corner
        return OccupancyGrid(log_odds, known, self.resolution_m, cell_corner(row + first, column, self.resolution_m))

    def whole(self) -> OccupancyGrid:
        """Unfold all of it."""
        return self.rows(0, self.shape[0])
