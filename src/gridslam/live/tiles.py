"""Changes of a map: detected on the filter's side by tile ids, numbered for the viewers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray

from gridslam.grid.arena import Int32Array
from gridslam.grid.cells import LOG_ODDS_UNIT, cell_corner
from gridslam.grid.tiles import TileMaps
from gridslam.kernels import TILE, UNKNOWN
from gridslam.live.protocol import levels
from gridslam.types import FloatArray, IntArray, OccupancyGrid

__all__ = ["EMPTY_BOX", "Box", "TileChangeDetector", "TileChanges", "TileReplica", "split_into_tiles", "tile_offset"]

_MARGIN_M = 2 * TILE * 0.05  # deskewing may move the end point of a beam this far


@final
@dataclass(frozen=True, slots=True)
class Box:
    """A rectangle of the map frame in which maps may have changed, m."""

    low: tuple[float, float]
    high: tuple[float, float]

    @classmethod
    def around(cls, poses: FloatArray, reach_m: float) -> Box:
        """Return the box that scans of this reach from poses (K, 3), K >= 1, can have changed."""
        reach = reach_m + _MARGIN_M
        (x0, y0), (x1, y1) = poses[:, :2].min(axis=0).tolist(), poses[:, :2].max(axis=0).tolist()
        return cls((x0 - reach, y0 - reach), (x1 + reach, y1 + reach))


EMPTY_BOX = Box((1.0, 1.0), (-1.0, -1.0))
"""A box that contains nothing."""


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
    """Detects the changes of one map since the last call; used by the filter's thread only.

    Tiles are shared and copied on write: a tile may have changed if its id in the table changed, or if it lies where
    some particle's map was updated since then.
    """

    __slots__ = ("_corner", "_ids")

    def __init__(self) -> None:
        """Start with an empty map."""
        self._ids: Int32Array = np.zeros((1, 1), np.int32)
        self._corner = (0, 0)

    def find_changes(self, maps: TileMaps, row: int, written: Box | None) -> TileChanges:
        """Copy the tiles of map `row` that may have changed.

        `written` marks the tiles written since the last look; None where that is unknown, or where these are
        other maps than those looked at before.
        """
        ids, corner = maps.tile_ids(row)
        before, before_at = self._ids, self._corner
        self._ids, self._corner = ids, corner
        if before.shape != ids.shape or before_at != corner:
            origin = min(corner[0], before_at[0]), min(corner[1], before_at[1])
            ends = [max(corner[k] + ids.shape[k], before_at[k] + before.shape[k]) for k in (0, 1)]
            shape = ends[0] - origin[0], ends[1] - origin[1]
            ids, before = _embed(ids, corner, origin, shape), _embed(before, before_at, origin, shape)
            corner = origin
        changed = ids != before
        if written is None:
            changed |= ids != 0
        else:
            side = TILE * maps.resolution_m
            low = [max(int(written.low[1 - k] // side) - corner[k], 0) for k in (0, 1)]
            high = [max(int(written.high[1 - k] // side) - corner[k] + 1, 0) for k in (0, 1)]
            inside = slice(low[0], high[0]), slice(low[1], high[1])
            changed[inside] |= ids[inside] != 0
        rows, columns = np.nonzero(changed)
        at = np.stack([rows + corner[0], columns + corner[1]], axis=1).astype(np.int32)
        return TileChanges(at, maps.tiles(ids[rows, columns]))


def _embed(table: Int32Array, at: tuple[int, int], origin: tuple[int, int], shape: tuple[int, int]) -> Int32Array:
    """Return a table embedded in a larger frame of zeros."""
    framed = np.zeros(shape, np.int32)
    row, column = at[0] - origin[0], at[1] - origin[1]
    framed[row : row + table.shape[0], column : column + table.shape[1]] = table
    return framed


@final
class TileReplica:
    """A copy of one map, built from its changes; each visible change of a tile gets the next sequence number."""

    __slots__ = ("_at", "_cells", "_numbers", "_slots", "sequence")

    def __init__(self) -> None:
        """Start with an empty map."""
        self._slots: dict[tuple[int, int], int] = {}
        self._cells = _unknown(64)
        self._at: Int32Array = np.zeros((64, 2), np.int32)
        self._numbers: IntArray = np.zeros(64, np.int64)
        self.sequence = 0

    @classmethod
    def of(cls, grid: OccupancyGrid) -> TileReplica:
        """Copy a rectangular map."""
        replica = cls()
        replica.apply(split_into_tiles(grid))
        return replica

    def __len__(self) -> int:
        """Return the number of tiles, including those that became unknown again."""
        return len(self._slots)

    def apply(self, changes: TileChanges) -> None:
        """Apply changed tiles; those without a visible change get no new number."""
        if not len(changes.at):
            return
        slots = np.array([self._slot_of(row, column) for row, column in changes.at.tolist()])
        before = self._cells[slots]
        changed = np.flatnonzero((changes.log_odds != before).any(axis=(1, 2)))
        seen = (levels(changes.log_odds[changed]) != levels(before[changed])).any(axis=(1, 2))
        self._cells[slots[changed]] = changes.log_odds[changed]
        self._numbers[slots[changed[seen]]] = self.sequence + 1 + np.arange(seen.sum())
        self.sequence += int(seen.sum())

    def replace(self, changes: TileChanges) -> None:
        """Replace the whole map by these tiles."""
        kept = set(map(tuple, changes.at.tolist()))
        gone = [at for at in self._slots if at not in kept]
        self.apply(TileChanges(np.array(gone, np.int32).reshape(-1, 2), _unknown(len(gone))))
        self.apply(changes)

    def since(self, number: int, most: int) -> tuple[Int32Array, NDArray[np.uint8], int]:
        """Return rows and columns (K, 2), levels (K, 32, 32) and last number of the next `most` tiles after a number.

        Tiles have their current levels; all tiles up to `sequence` are the whole map.
        """
        numbers = self._numbers[: len(self)]
        newer = np.flatnonzero(numbers > number)
        if len(newer) > most:
            newer = newer[np.argpartition(numbers[newer], most)[:most]]
            number = int(numbers[newer].max())
        else:
            number = self.sequence
        return self._at[newer], levels(self._cells[newer]), number

    def grid(self, resolution_m: float) -> OccupancyGrid:
        """Return the map as a rectangle around its known tiles; a single unknown cell if there are none."""
        used = np.flatnonzero((self._cells[: len(self)] != UNKNOWN).any(axis=(1, 2)))
        if not len(used):
            return OccupancyGrid(np.zeros((1, 1), np.float32), np.zeros((1, 1), np.bool_), resolution_m, (0.0, 0.0))
        at = self._at[used]
        low, high = at.min(axis=0), at.max(axis=0) + 1
        blocks = np.full((*(high - low), TILE, TILE), UNKNOWN, np.int16)
        blocks[tuple((at - low).T)] = self._cells[used]
        cells = blocks.swapaxes(1, 2).reshape(int(high[0] - low[0]) * TILE, -1)
        known = cells != UNKNOWN
        log_odds = np.where(known, cells, 0).astype(np.float32) * np.float32(LOG_ODDS_UNIT)
        row, column = (low * TILE).tolist()
        return OccupancyGrid(log_odds, known, resolution_m, cell_corner(row, column, resolution_m))

    def _slot_of(self, row: int, column: int) -> int:
        """Return the slot of a tile, which is added as unknown if it is new."""
        slot = self._slots.setdefault((row, column), len(self._slots))
        if slot == len(self._cells):
            more = len(self._cells)
            self._cells = np.concatenate([self._cells, _unknown(more)])
            self._at = np.concatenate([self._at, np.zeros((more, 2), np.int32)])
            self._numbers = np.concatenate([self._numbers, np.zeros(more, np.int64)])
        if slot == len(self._slots) - 1:
            self._at[slot] = row, column
        return slot


def _unknown(count: int) -> NDArray[np.int16]:
    return np.full((count, TILE, TILE), UNKNOWN, np.int16)


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
    rows, columns = -(-(row + height) // TILE) - first[0], -(-(column + width) // TILE) - first[1]
    cells = np.full((rows * TILE, columns * TILE), UNKNOWN, np.int16)
    steps = np.clip(np.rint(grid.log_odds / np.float32(LOG_ODDS_UNIT)), UNKNOWN + 1, -UNKNOWN - 1)
    top, left = row - first[0] * TILE, column - first[1] * TILE
    cells[top : top + height, left : left + width] = np.where(grid.known, steps, UNKNOWN).astype(np.int16)
    blocks = cells.reshape(rows, TILE, columns, TILE).swapaxes(1, 2)
    used = np.nonzero((blocks != UNKNOWN).any(axis=(2, 3)))
    at = np.stack(used, axis=1).astype(np.int32) + np.array(first, np.int32)
    return TileChanges(at, blocks[used])
