"""Changes of a map: detected on the filter's side by tile ids, numbered for the viewers."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import takewhile
from typing import final

import numpy as np
from numpy.typing import NDArray

from gridslam.grid.cells import LOG_ODDS_UNIT
from gridslam.grid.tiles import TileMaps
from gridslam.kernels import TILE, UNKNOWN
from gridslam.live.protocol import levels
from gridslam.types import Int32Array, IntArray, OccupancyGrid

_UNKNOWN_TILE: NDArray[np.int16] = np.full((TILE, TILE), UNKNOWN, np.int16)
_UNKNOWN_LEVELS: NDArray[np.uint8] = np.zeros((TILE, TILE), np.uint8)


@final
@dataclass(frozen=True, slots=True, eq=False)
class TileChanges:
    """Tiles that may have changed.

    Attributes
    ----------
    at : (K, 2) int32
        Their rows and columns, in tiles; cell (0, 0) of tile (0, 0) has its corner at the map's origin.
    log_odds : (K, 32, 32) int16
        Their current cells, in units of `gridslam.grid.cells.LOG_ODDS_UNIT`, or `UNKNOWN`.
    """

    at: Int32Array
    log_odds: NDArray[np.int16]


@final
class TileChangeDetector:
    """Detects the changes of the map of one particle since the last call; used by the filter's thread only.

    It owns that map until the next call: the filter copies a tile before it writes to it, so that only tiles that have
    another id by then can have changed.
    """

    __slots__ = ("_corner", "_ids", "_owned")

    def __init__(self) -> None:
        """Start with an empty map."""
        self._ids: Int32Array = np.zeros((1, 1), np.int32)
        self._corner = (0, 0)
        self._owned: TileMaps | None = None

    def forget(self) -> None:
        """Give the map back; all tiles may have changed by the next call."""
        self._owned = None

    def find_changes(self, maps: TileMaps, row: int) -> TileChanges:
        """Copy the tiles of map `row` that may have changed; all of them where these are other maps than before."""
        is_same = self._owned is not None and maps.shares_tiles(self._owned)
        now = maps.tile_ids(row)
        ids, before, origin = _align(now, (self._ids, self._corner))
        self._ids, self._corner = now
        changed = ids != before if is_same else (ids != before) | (ids != 0)
        at = (np.argwhere(changed) + origin).astype(np.int32)
        tiles = maps.tiles(ids[changed])
        self._owned = maps.snapshot(np.array([row]))
        return TileChanges(at, tiles)


def _align(*tables: tuple[Int32Array, tuple[int, int]]) -> tuple[Int32Array, Int32Array, IntArray]:
    """Return two tables of ids over the same tiles, and the row and column of their corner."""
    (one, corner), (other, at) = tables
    if corner == at and one.shape == other.shape:
        return one, other, np.array(corner)
    corners = np.array([corner, at])
    origin = corners.min(axis=0)
    end = (corners + [table.shape for table in (one, other)]).max(axis=0)
    wide: list[Int32Array] = []
    for table, (row, column) in ((one, corners[0] - origin), (other, corners[1] - origin)):
        wide.append(np.zeros(end - origin, np.int32))
        wide[-1][row : row + table.shape[0], column : column + table.shape[1]] = table
    return wide[0], wide[1], origin


@final
class TileReplica:
    """A copy of one map, built from its changes; each visible change of a tile gets the next sequence number."""

    __slots__ = ("_levels", "_numbers", "sequence")

    def __init__(self) -> None:
        """Start with an empty map."""
        self._levels: dict[tuple[int, int], NDArray[np.uint8]] = {}  # of visible tiles, by row and column
        self._numbers: dict[tuple[int, int], int] = {}  # in ascending order
        self.sequence = 0

    @classmethod
    def of(cls, grid: OccupancyGrid) -> TileReplica:
        """Copy a rectangular map."""
        replica = cls()
        replica.apply(split_into_tiles(grid))
        return replica

    def apply(self, changes: TileChanges) -> None:
        """Apply changed tiles; those without a visible change get no new number."""
        looks = levels(changes.log_odds)
        for (row, column), look in zip(changes.at.tolist(), looks, strict=True):
            if not np.array_equal(look, self._levels.get((row, column), _UNKNOWN_LEVELS)):
                self._levels[row, column] = look.copy()
                self.sequence += 1
                self._numbers.pop((row, column), None)
                self._numbers[row, column] = self.sequence

    def replace(self, changes: TileChanges) -> None:
        """Replace the whole map by these tiles."""
        gone = list(self._levels.keys() - set(map(tuple, changes.at.tolist())))
        unknown = np.broadcast_to(_UNKNOWN_TILE, (len(gone), TILE, TILE))
        self.apply(TileChanges(np.array(gone, np.int32).reshape(-1, 2), unknown))
        self.apply(changes)

    def since(self, number: int, most: int) -> tuple[Int32Array, NDArray[np.uint8], int]:
        """Return rows and columns (K, 2), levels (K, 32, 32) and last number of the next `most` tiles after a number.

        Tiles have their current levels; all tiles up to `sequence` are the whole map.
        """
        newer = [*takewhile(lambda item: item[1] > number, reversed(self._numbers.items()))][::-1]
        last = newer[most - 1][1] if len(newer) > most else self.sequence
        at = [at for at, _ in newer[:most]]
        looks = np.array([self._levels[one] for one in at], np.uint8).reshape(-1, TILE, TILE)
        return np.array(at, np.int32).reshape(-1, 2), looks, last


def tile_offset(grid: OccupancyGrid) -> tuple[float, float]:
    """Return the offset of the cells of a rectangular map from the grid of the tiles (x m, y m)."""
    side = grid.resolution_m
    x, y = (float(corner) - side * round(corner / side) for corner in grid.origin)
    return x, y


def split_into_tiles(grid: OccupancyGrid) -> TileChanges:
    """Return the known tiles of a rectangular map, whose cells are moved to the nearest cells of the tiles' grid."""
    height, width = grid.known.shape
    column, row = (round(corner / grid.resolution_m) for corner in grid.origin)
    first = row // TILE, column // TILE
    rows = -(-(row + height) // TILE) - first[0]
    columns = -(-(column + width) // TILE) - first[1]
    cells = np.full((rows * TILE, columns * TILE), UNKNOWN, np.int16)
    steps = np.clip(np.rint(grid.log_odds / np.float32(LOG_ODDS_UNIT)), UNKNOWN + 1, -UNKNOWN - 1)
    top = row - first[0] * TILE
    left = column - first[1] * TILE
    cells[top : top + height, left : left + width] = np.where(grid.known, steps, UNKNOWN).astype(np.int16)
    blocks = cells.reshape(rows, TILE, columns, TILE).swapaxes(1, 2)
    used = np.nonzero((blocks != UNKNOWN).any(axis=(2, 3)))
    at = np.stack(used, axis=1).astype(np.int32) + np.array(first, np.int32)
    return TileChanges(at, blocks[used])
