"""A map as a rectangle of cells that stays in its tiles, and is unfolded a few rows at a time."""

from __future__ import annotations

from typing import TYPE_CHECKING, final

import numpy as np
from numpy.typing import NDArray

from gridslam.grid.evidence import LOG_ODDS_UNIT
from gridslam.grid.frame import cell_corner
from gridslam.kernels import TILE, UNKNOWN
from gridslam.types import OccupancyGrid

if TYPE_CHECKING:
    from gridslam.grid.tiles import TileMaps

__all__ = ["TiledGrid", "cut"]


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
        ids, (row0, column0) = maps.tile_ids(row)
        self._cut = rows, columns = cut(ids)
        self._corner = (row0 + rows.start) * TILE, (column0 + columns.start) * TILE
        self.shape = (rows.stop - rows.start) * TILE, (columns.stop - columns.start) * TILE
        if not ids.any():
            self._corner, self.shape = (0, 0), (1, 1)
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


def cut(ids: NDArray[np.int32]) -> tuple[slice, slice]:
    """The rows and columns of ids (R, C) of tiles from the first to the last that is not 0; the first, if all are."""
    rows, columns = (np.append(np.flatnonzero(ids.any(axis=axis)), [0] * (not ids.any())) for axis in (1, 0))
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)
