"""The pool of tiles and pages that the maps of all particles share, counted by references."""

from __future__ import annotations

from typing import final

import numpy as np
from numpy.typing import NDArray

from gridslam.kernels import PAGE, TILE, UNKNOWN

__all__ = ["TileArena"]

Int32Array = NDArray[np.int32]


@final
class TileArena:
    """Tiles (log-odds and distance field), pages of tile ids, and how often each is used. Id 0 is the empty one.

    Attributes
    ----------
    pages : (K, 16, 16) int32
        Tile ids.
    log_odds : (T, 32, 32) int16
        In units of `gridslam.grid.LOG_ODDS_UNIT` nats; -32768 is unknown.
    field : (T, 32, 32) uint8
        255 at an occupied cell, falling linearly with the distance to 0 at the field's reach.
    """

    __slots__ = ("_free_pages", "_free_tiles", "field", "log_odds", "page_refs", "pages", "tile_refs")

    def __init__(self) -> None:
        self.pages = np.zeros((8, PAGE, PAGE), np.int32)
        self.log_odds = np.full((64, TILE, TILE), UNKNOWN, np.int16)
        self.field = np.zeros((64, TILE, TILE), np.uint8)
        self.page_refs = np.zeros(8, np.int32)
        self.tile_refs = np.zeros(64, np.int32)
        self._free_pages: Int32Array = np.arange(7, 0, -1, dtype=np.int32)
        self._free_tiles: Int32Array = np.arange(63, 0, -1, dtype=np.int32)

    @property
    def tiles_used(self) -> int:
        """Number of tiles that some map uses."""
        return len(self.tile_refs) - 1 - len(self._free_tiles)

    @property
    def nbytes(self) -> int:
        """Bytes held, used or not."""
        return self.pages.nbytes + self.log_odds.nbytes + self.field.nbytes + self.page_refs.nbytes + self.tile_refs.nbytes

    def spare(self, n: int) -> tuple[Int32Array, Int32Array]:
        """Free page and tile ids, at least `n` of each; taken from the end by `take`."""
        if len(self._free_pages) < n:
            old, new = self._grow(len(self.page_refs), n - len(self._free_pages))
            self.pages.resize((new, PAGE, PAGE), refcheck=False)
            self.page_refs.resize(new, refcheck=False)
            self._free_pages = np.concatenate([np.arange(new - 1, old - 1, -1, dtype=np.int32), self._free_pages])
        if len(self._free_tiles) < n:
            old, new = self._grow(len(self.tile_refs), n - len(self._free_tiles))
            # resize extends large arrays in place: no second copy of the maps is ever held
            self.log_odds.resize((new, TILE, TILE), refcheck=False)
            self.field.resize((new, TILE, TILE), refcheck=False)
            self.tile_refs.resize(new, refcheck=False)
            self._free_tiles = np.concatenate([np.arange(new - 1, old - 1, -1, dtype=np.int32), self._free_tiles])
        return self._free_pages, self._free_tiles

    @staticmethod
    def _grow(size: int, missing: int) -> tuple[int, int]:
        return size, size + max(missing, size // 4, 64)

    def take(self, pages: int, tiles: int) -> None:
        """Mark the last `pages` and `tiles` spare ids as used."""
        self._free_pages = self._free_pages[: len(self._free_pages) - pages]
        self._free_tiles = self._free_tiles[: len(self._free_tiles) - tiles]

    def retain(self, roots: Int32Array) -> None:
        """Count one more use of every page in `roots`."""
        self.page_refs += np.bincount(roots.ravel(), minlength=len(self.page_refs)).astype(np.int32)

    def release(self, roots: Int32Array) -> None:
        """Count one use less of every page in `roots`; what nothing uses any more becomes free."""
        counts = np.bincount(roots.ravel(), minlength=len(self.page_refs))
        counts[0] = 0
        self.page_refs -= counts.astype(np.int32)
        dead_pages = np.flatnonzero((counts > 0) & (self.page_refs == 0))
        if not len(dead_pages):
            return
        self._free_pages = np.concatenate([self._free_pages, dead_pages.astype(np.int32)])
        tiles = np.bincount(self.pages[dead_pages].ravel(), minlength=len(self.tile_refs))
        tiles[0] = 0
        self.tile_refs -= tiles.astype(np.int32)
        dead_tiles = np.flatnonzero((tiles > 0) & (self.tile_refs == 0))
        self._free_tiles = np.concatenate([self._free_tiles, dead_tiles.astype(np.int32)])
