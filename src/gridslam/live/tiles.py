"""Changes of a map: detected on the filter's side by tile ids, numbered for the viewers."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import takewhile
from typing import TypeAlias, final

import numpy as np
from numpy.typing import NDArray

from gridslam.grid.cells import LOG_ODDS_UNIT
from gridslam.grid.tiles import TileMaps
from gridslam.kernels import TILE, UNKNOWN
from gridslam.live.protocol import levels, pack_tiles
from gridslam.types import Int32Array, IntArray, OccupancyGrid

PackedTiles: TypeAlias = dict[tuple[int, int], bytes]
"""Levels of tiles by row and column, as `gridslam.live.protocol.pack_tiles` packs them."""

TILE_BYTES = TILE * TILE // 2
_UNKNOWN_TILE = bytes(TILE_BYTES)


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
    begins = np.array([corner for _, corner in tables])
    ends = begins + [ids.shape for ids, _ in tables]
    margins = np.stack([begins - begins.min(axis=0), ends.max(axis=0) - ends], axis=2)
    one, other = (np.pad(ids, around) for (ids, _), around in zip(tables, margins, strict=True))
    return one, other, begins.min(axis=0)


@final
class TileReplica:
    """A map as it is shown, in packed levels; each visible change of a tile gets the next sequence number.

    The filter's thread writes it, the server's thread reads it.
    """

    __slots__ = ("_lock", "_numbers", "_tiles", "sequence")

    def __init__(self) -> None:
        """Start with an empty map."""
        self._tiles: PackedTiles = {}
        self._numbers: dict[tuple[int, int], int] = {}  # in ascending order
        self.sequence = 0
        self._lock = threading.Lock()

    @classmethod
    def of(cls, grid: OccupancyGrid) -> TileReplica:
        """Copy a rectangular map."""
        replica = cls()
        replica.apply(split_into_tiles(grid))
        return replica

    def apply(self, changes: TileChanges) -> None:
        """Apply changed tiles; those without a visible change get no new number."""
        packed = pack_tiles(levels(changes.log_odds))
        at = map(tuple, changes.at.tolist())
        self._put(zip(at, map(np.ndarray.tobytes, packed), strict=True))

    def replace(self, tiles: PackedTiles) -> None:
        """Replace the whole map by these tiles."""
        self._put((at, _UNKNOWN_TILE) for at in self._tiles.keys() - tiles.keys())
        self._put(tiles.items())

    def since(self, number: int, most: int = sys.maxsize) -> tuple[Int32Array, NDArray[np.uint8], int]:
        """Return rows and columns (K, 2), packed levels (K, 512) and last number of the next `most` tiles after one.

        Tiles have their current levels; all tiles up to `sequence` are the whole map.
        """
        with self._lock:
            newer = [*takewhile(lambda item: item[1] > number, reversed(self._numbers.items()))][::-1]
            last = newer[most - 1][1] if len(newer) > most else self.sequence
            at = [at for at, _ in newer[:most]]
            packed = np.frombuffer(b"".join(self._tiles[one] for one in at), np.uint8)
        return np.array(at, np.int32).reshape(-1, 2), packed.reshape(-1, TILE_BYTES), last

    def _put(self, tiles: Iterable[tuple[tuple[int, int], bytes]]) -> None:
        with self._lock:
            for at, packed in tiles:
                if self._tiles.get(at, _UNKNOWN_TILE) != packed:
                    self._tiles[at] = packed
                    self.sequence += 1
                    self._numbers.pop(at, None)
                    self._numbers[at] = self.sequence


def tile_offset(grid: OccupancyGrid) -> tuple[float, float]:
    """Return the offset of the cells of a rectangular map from the grid of the tiles (x m, y m)."""
    side = grid.resolution_m
    x, y = (float(corner) - side * round(corner / side) for corner in grid.origin)
    return x, y


def split_into_tiles(grid: OccupancyGrid) -> TileChanges:
    """Return the known tiles of a rectangular map, whose cells are moved to the nearest cells of the tiles' grid."""
    column, row = (round(corner / grid.resolution_m) for corner in grid.origin)
    steps = np.clip(np.rint(grid.log_odds / np.float32(LOG_ODDS_UNIT)), UNKNOWN + 1, -UNKNOWN - 1)
    known = np.where(grid.known, steps, UNKNOWN).astype(np.int16)
    margins = [(first % TILE, -(first + side) % TILE) for first, side in zip((row, column), known.shape, strict=True)]
    cells = np.pad(known, margins, constant_values=UNKNOWN)
    height, width = cells.shape
    blocks = cells.reshape(height // TILE, TILE, width // TILE, TILE).swapaxes(1, 2)
    used = np.nonzero((blocks != UNKNOWN).any(axis=(2, 3)))
    at = np.stack(used, axis=1).astype(np.int32) + np.array([row // TILE, column // TILE], np.int32)
    return TileChanges(at, blocks[used])
