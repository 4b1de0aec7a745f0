"""The pool of tiles and pages that the maps of all particles share, counted by references."""

from __future__ import annotations

from typing import final

import numpy as np
from numpy.typing import NDArray

from gridslam.arguments import require_array
from gridslam.errors import ArgumentError
from gridslam.kernels import PAGE, TILE, UNKNOWN
from gridslam.kernels.reference_update import LogOdds, unknown_of
from gridslam.types import Int32Array, IntArray

_MOVED = 1024
"""Tiles that are copied at a time."""


@final
class TileArena:
    """Tiles (log-odds and distance field), pages of tile ids, and how often each is used. Id 0 is the empty one.

    It belongs to one thread.

    Parameters
    ----------
    byte_unit : int or None
        Unit, in steps of `gridslam.grid.LOG_ODDS_UNIT`, of which every log-odds is a multiple that fits in a byte; None
        where there is none.

    Attributes
    ----------
    pages : (K, 16, 16) int32
        Tile ids.
    log_odds : (T, 32, 32) int8 or int16
        In units of `unit`; the least value of the type is unknown.
    unit : int
        In steps of `gridslam.grid.LOG_ODDS_UNIT` nats; 1 where log-odds are int16.
    field : (T, 32, 32) uint8
        255 at an occupied cell, falling linearly with the distance to 0 at the field's reach.
    """

    __slots__ = (
        *("_free_pages", "_free_tiles"),
        *("field", "log_odds", "page_refs", "pages", "tile_refs", "unit"),
    )

    def __init__(self, byte_unit: int | None = None) -> None:
        self.pages = np.zeros((8, PAGE, PAGE), np.int32)
        stored = np.int16 if byte_unit is None else np.int8
        self.log_odds: LogOdds = np.full((64, TILE, TILE), np.iinfo(stored).min, stored)
        self.unit = byte_unit or 1
        self.field = np.zeros((64, TILE, TILE), np.uint8)
        self.page_refs = np.zeros(8, np.int32)
        self.tile_refs = np.zeros(64, np.int32)
        self._free_pages: Int32Array = np.arange(7, 0, -1, dtype=np.int32)
        self._free_tiles: Int32Array = np.arange(63, 0, -1, dtype=np.int32)

    @classmethod
    def from_arrays(
        cls,
        roots: Int32Array,
        pages: Int32Array,
        log_odds: NDArray[np.int16],
        field: NDArray[np.uint8],
        byte_unit: int | None = None,
    ) -> TileArena:
        """Build the arena whose pages and tiles are all in use by the one table `roots`; copies.

        Log-odds (T, 32, 32) are in steps of `gridslam.grid.LOG_ODDS_UNIT`, `UNKNOWN` where nothing is known. They are
        stored as bytes if these hold them exactly.

        Raises
        ------
        ArgumentError
            A dtype or shape is wrong, id 0 is not empty, or an id is unknown or unused.
        """
        require_array("roots", roots, np.int32, (None, None, None))
        require_array("pages", pages, np.int32, (None, PAGE, PAGE))
        require_array("log_odds", log_odds, np.int16, (None, TILE, TILE))
        require_array("field", field, np.uint8, log_odds.shape)
        if not roots.size:
            raise ArgumentError("roots", "at least one map of at least one page", f"shape {roots.shape}")
        if pages[:1].any() or (log_odds[:1] != UNKNOWN).any() or field[:1].any() or not (len(pages) and len(log_odds)):
            raise ArgumentError("pages, log_odds, field", "an empty page and an empty tile first", "something in them")
        packed = None if byte_unit is None else _pack(log_odds, byte_unit)
        arena = cls(None if packed is None else byte_unit)
        arena.pages = pages.copy()
        arena.log_odds = log_odds.copy() if packed is None else packed
        arena.field = field.copy()
        arena.page_refs = _count_uses("roots", roots, len(pages))
        arena.tile_refs = _count_uses("pages", pages, len(log_odds))
        arena._free_pages = arena._free_tiles = np.zeros(0, np.int32)
        return arena

    @property
    def tiles_used(self) -> int:
        """Number of tiles that some map uses."""
        return len(self.tile_refs) - 1 - len(self._free_tiles)

    @property
    def nbytes(self) -> int:
        """Bytes held, used or not."""
        held = (self.pages, self.log_odds, self.field, self.page_refs, self.tile_refs)
        return sum(array.nbytes for array in held)

    @property
    def free_ids(self) -> tuple[Int32Array, Int32Array]:
        """Free page and tile ids; they are taken from the end by `allocate`."""
        return self._free_pages, self._free_tiles

    def grow(self) -> None:
        """Grow the pages or tiles, or both, by a 32nd where none is free, in place: no second copy is ever held.

        Ids are free only once their memory is there: after a MemoryError all is as it was.
        """
        if not len(self._free_pages):
            free, new = self._extend_ids(self.page_refs)
            self.pages.resize((new, PAGE, PAGE), refcheck=False)
            self.page_refs.resize(new, refcheck=False)
            self._free_pages = free
        if not len(self._free_tiles):
            free, new = self._extend_ids(self.tile_refs)
            self.log_odds.resize((new, TILE, TILE), refcheck=False)
            self.field.resize((new, TILE, TILE), refcheck=False)
            self.tile_refs.resize(new, refcheck=False)
            self._free_tiles = free

    @staticmethod
    def _extend_ids(refs: Int32Array) -> tuple[Int32Array, int]:
        """Return ids to be added to those that `refs` counts, to be taken from the end, and how many there are then."""
        size = min(len(refs) + max(len(refs) // 32, 64), np.iinfo(np.int32).max)
        return np.arange(size - 1, len(refs) - 1, -1, dtype=np.int32), size

    def allocate(self, pages: int, tiles: int) -> None:
        """Mark the last `pages` and `tiles` spare ids as used."""
        self._free_pages = self._free_pages[: len(self._free_pages) - pages]
        self._free_tiles = self._free_tiles[: len(self._free_tiles) - tiles]

    def retain(self, roots: Int32Array) -> None:
        """Count one more use of every page in `roots`."""
        self.page_refs += _uses(roots, len(self.page_refs))

    def release(self, roots: Int32Array) -> None:
        """Decrement the use count of every page in `roots`; unused ones become free."""
        dead_pages = _release(self.page_refs, roots)
        if len(dead_pages):
            dead_tiles = _release(self.tile_refs, self.pages[dead_pages])
            self._free_pages = np.concatenate([self._free_pages, dead_pages])
            self._free_tiles = np.concatenate([self._free_tiles, dead_tiles])

    def tiles_of(self, roots: Int32Array) -> int:
        """Return number of tiles on the pages of `roots`, each counted once."""
        pages = np.zeros(len(self.pages), np.bool_)
        tiles = np.zeros(len(self.log_odds), np.bool_)
        pages[roots] = True
        tiles[self.pages[pages]] = True
        return int(np.count_nonzero(tiles[1:]))

    def steps_of(self, tiles: IntArray | Int32Array) -> NDArray[np.int16]:
        """Return log-odds (K, 32, 32) of tiles (K,) in steps of `gridslam.grid.LOG_ODDS_UNIT`; `UNKNOWN` is unknown."""
        return _unpack(self.log_odds[tiles], self.unit)

    def widen(self) -> None:
        """Store log-odds in two bytes each, which hold every number of steps."""
        self.log_odds = _unpack(self.log_odds, self.unit)
        self.unit = 1

    def compact(self) -> None:
        """Move the tiles in use to the front, in their order, and give the memory behind them back."""
        used = np.append(0, np.flatnonzero(self.tile_refs))
        places = np.zeros(len(self.tile_refs), np.int32)
        places[used] = np.arange(len(used), dtype=np.int32)
        self.pages[:] = places[self.pages]
        for first in range(0, len(used), _MOVED):
            tiles = used[first : first + _MOVED]  # none of them lies before its new place, where others were moved to
            self.log_odds[first : first + len(tiles)] = self.log_odds[tiles]
            self.field[first : first + len(tiles)] = self.field[tiles]
        self.log_odds.resize((len(used), TILE, TILE), refcheck=False)
        self.field.resize((len(used), TILE, TILE), refcheck=False)
        self.tile_refs = self.tile_refs[used]
        self._free_tiles = np.zeros(0, np.int32)


def _unpack(stored: LogOdds, unit: int) -> NDArray[np.int16]:
    """Convert stored log-odds of `unit` steps to steps of `gridslam.grid.LOG_ODDS_UNIT`."""
    if stored.dtype == np.int16:
        return np.asarray(stored, np.int16)
    steps = np.multiply(stored, unit, dtype=np.int16)
    np.copyto(steps, UNKNOWN, where=stored == unknown_of(stored))
    return steps


def _pack(steps: NDArray[np.int16], unit: int) -> NDArray[np.int8] | None:
    """Multiples of `unit` in a byte each; None where they are not exact."""
    limits = np.iinfo(np.int8)
    stored: NDArray[np.int8] = np.clip(steps // unit, limits.min + 1, limits.max).astype(np.int8)
    np.copyto(stored, limits.min, where=steps == UNKNOWN)
    return stored if np.array_equal(_unpack(stored, unit), steps) else None


def renumber(ids: Int32Array) -> tuple[Int32Array, IntArray]:
    """The table `ids` with its ids counted from 1 in order of appearance, 0 kept; and the old id of each new one."""
    old, first, index = np.unique(np.append(np.int32(0), ids), return_index=True, return_inverse=True)
    order = np.argsort(first)
    new = np.empty(len(old), np.int32)
    new[order] = np.arange(len(old), dtype=np.int32)
    return new[index.ravel()[1:]].reshape(ids.shape), old[order].astype(np.int64)


def _uses(ids: Int32Array, size: int) -> Int32Array:
    """Return how often each id below `size` occurs in `ids`, 0 for the empty one."""
    counts = np.bincount(ids.ravel(), minlength=size).astype(np.int32)
    counts[0] = 0
    return counts


def _release(refs: Int32Array, ids: Int32Array) -> Int32Array:
    """Count uses less in `refs`; the ids that nothing uses any more."""
    uses = _uses(ids, len(refs))
    refs -= uses
    return np.flatnonzero((uses > 0) & (refs == 0)).astype(np.int32)


def _count_uses(name: str, ids: Int32Array, size: int) -> Int32Array:
    """Return how often each id below `size` occurs in `ids`, 0 for the empty one; every other one must."""
    if ids.size and (ids.min() < 0 or ids.max() >= size):
        raise ArgumentError(name, f"ids from 0 to {size - 1}", f"{ids.min()} to {ids.max()}")
    counts = _uses(ids, size)
    if not counts[1:].all():
        raise ArgumentError(name, f"every id from 1 to {size - 1} in use", f"no use of {1 + int(counts[1:].argmin())}")
    return counts
