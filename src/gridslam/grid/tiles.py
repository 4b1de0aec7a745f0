"""Copy-on-write tiled maps: one map for each particle, at the cost of the tiles in which it differs from the others."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from gridslam.errors import ArgumentError
from gridslam.grid.arena import Int32Array, TileArena, renumber
from gridslam.grid.cells import LOG_ODDS_UNIT, Evidence, cell_corner, cells_of
from gridslam.kernels import PAGE, TILE, UNKNOWN, backend
from gridslam.kernels.reference_update import cell_addresses
from gridslam.types import BeamEnds, FloatArray, IntArray, OccupancyGrid, Rows

__all__ = ["TileMaps", "TiledGrid"]


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

    __slots__ = ("_corner", "_maps", "origin", "resolution_m", "shape")

    def __init__(self, maps: TileMaps, row: int) -> None:
        """Take map `row` as it is now."""
        self._maps = maps.snapshot(np.array([row]))
        ids, (tile_row, tile_column) = maps.tile_ids(row)
        self._corner = tile_row * TILE, tile_column * TILE
        self.shape = (len(ids) * TILE, ids.shape[1] * TILE) if ids.any() else (1, 1)
        self.resolution_m = maps.resolution_m
        self.origin = cell_corner(*self._corner, maps.resolution_m)

    def rows(self, first: int, last: int) -> OccupancyGrid:
        """Unfold rows `first` to `last` - 1."""
        ids = self._maps.tile_ids(0)[0][first // TILE : -(-last // TILE)]
        log_odds = np.empty((len(ids) * TILE, ids.shape[1] * TILE), np.float32)
        known = np.empty(log_odds.shape, np.bool_)
        for tile_row, strip_ids in enumerate(ids):
            strip = slice(tile_row * TILE, (tile_row + 1) * TILE)
            cells = self._maps.tiles(strip_ids).swapaxes(0, 1).reshape(TILE, -1)
            np.not_equal(cells, UNKNOWN, out=known[strip])
            log_odds[strip] = np.where(known[strip], cells, 0)
        log_odds *= LOG_ODDS_UNIT
        row, column = self._corner
        part = slice(first % TILE, first % TILE + last - first), slice(self.shape[1])
        corner = cell_corner(row + first, column, self.resolution_m)
        return OccupancyGrid(log_odds[part], known[part], self.resolution_m, corner)

    def whole(self) -> OccupancyGrid:
        """Unfold all of it."""
        return self.rows(0, self.shape[0])


@final
class TileMaps:
    """`rows` maps over one arena of tiles. Reading is for all; writing is for the one owner.

    Parameters
    ----------
    rows : int
        Number of maps.
    resolution_m : float
        Side of a cell.
    reach_cells : float
        Distance at which the field falls to 0, in [1, 15.5] cells.
    evidence : Evidence
        The inverse measurement model in log-odds.
    threads : int
        Threads of the kernels; never changes a result.
    """

    __slots__ = ("_arena", "_cone", "_first", "_roots", "evidence", "reach_cells", "resolution_m", "threads")

    def __init__(
        self, rows: int, *, resolution_m: float, reach_cells: float, evidence: Evidence, threads: int = 1
    ) -> None:
        if rows < 1:
            raise ArgumentError("rows", "at least one map", rows)
        if not resolution_m > 0:
            raise ArgumentError("resolution_m", "a positive length in m", resolution_m)
        if not 1 <= reach_cells <= 15.5:  # a cone must fit between the corners of two neighbouring tiles
            raise ArgumentError("reach_cells", "1 to 15.5 cells", reach_cells)
        self.resolution_m = resolution_m
        self.reach_cells = reach_cells
        self.evidence = evidence
        self.threads = threads
        self._arena = TileArena()
        self._roots: Int32Array = np.zeros((rows, 1, 1), np.int32)
        self._first = (0, 0)
        r = int(reach_cells)
        apart = np.hypot(*np.mgrid[-r : r + 1, -r : r + 1])
        self._cone: NDArray[np.uint8] = np.rint(255 * np.maximum(0, 1 - apart / reach_cells)).astype(np.uint8)

    def __del__(self) -> None:
        """Give the tiles back, so that other maps over the same arena stop copying them."""
        if hasattr(self, "_arena") and hasattr(self, "_roots"):
            self._arena.release(self._roots)

    def __len__(self) -> int:
        """Return the number of maps."""
        return len(self._roots)

    @property
    def reach_m(self) -> float:
        """Distance at which `distances` saturates."""
        return self.reach_cells * self.resolution_m

    @property
    def tiles_used(self) -> int:
        """Number of tiles that the arena's maps use together."""
        return self._arena.tiles_used

    def tiles_of(self, rows: IntArray) -> int:
        """Number of tiles that maps `rows` (K,) use together."""
        return self._arena.tiles_of(self._roots[rows])

    @property
    def nbytes(self) -> int:
        """Bytes held by the arena and this table."""
        return self._arena.nbytes + self._roots.nbytes

    @property
    def _view(self) -> tuple[Any, ...]:
        arena = self._arena
        return self._roots, self._first, arena.pages, arena.log_odds, arena.field

    def snapshot(self, rows: IntArray | None = None) -> TileMaps:
        """Another owner of all maps or of maps `rows` (K,), at the cost of their tables.

        Tiles are copied when either side writes.
        """
        roots = self._roots.copy() if rows is None else self._roots[rows]
        self._arena.retain(roots)  # before there is an owner who gives them back, should this fail
        twin = object.__new__(TileMaps)
        for name in TileMaps.__slots__:
            setattr(twin, name, getattr(self, name))
        twin._roots = roots
        return twin

    def select(self, parents: IntArray) -> None:
        """Let map i become what map parents[i] was; parents (rows,) int64."""
        roots = self._roots[parents]
        self._arena.retain(roots)
        self._arena.release(self._roots)
        self._roots = roots

    def compact(self) -> None:
        """Give the memory back that no map uses; ids of tiles change, and what is written to a map stays its own."""
        self._arena.compact()

    def clear(self, row: int) -> None:
        """Empty one map."""
        self._arena.release(self._roots[row])
        self._roots[row] = 0

    def update(self, rows: Int32Array, poses: FloatArray, beams: BeamEnds) -> None:
        """Insert a scan into maps `rows` (K,) int32, each at most once, at poses (K, 3): the binary Bayes filter.

        The cell at a beam's end is hit once for each beam, the cells before it are missed once for each; a cell in
        which some beam of the scan ends is not missed by it. The distance field follows.

        Source: Probabilistic Robotics, Table 9.1.
        """
        if not len(beams):
            return
        self._cover(poses, beams)
        self._make_writable(
            backend.tiles_on_rays(rows, poses, beams.ends, beams.origin, self.resolution_m, self.threads)
        )
        changed = backend.update_log_odds(
            *self._view, rows, poses, beams.ends, beams.origin, self.resolution_m, *self.evidence.steps, self.threads
        )
        if len(changed):
            self._make_writable(backend.tiles_near_cells(changed, int(self.reach_cells)))
            backend.update_field(*self._view, changed, self._cone, self.threads)

    def match(
        self, rows: Int32Array, guesses: FloatArray, priors: FloatArray, ends: FloatArray, *settings: float | bool
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Gauss-Newton from guesses (K, 3) with prior information (K, 3, 3); see `gridslam.matching.GaussNewton`."""
        found: tuple[FloatArray, FloatArray, FloatArray] = backend.match(
            *self._view, rows, guesses, priors, ends, self.resolution_m, *settings, self.threads
        )
        return found

    def distances(self, rows: Rows, poses: FloatArray, points: FloatArray) -> NDArray[np.float32]:
        """Distance in m (K, B) from points (B, 2) of the base frame at poses (K, 3) to the nearest obstacle's centre.

        Capped at `reach_m`; `rows` (K,): index of the map of each pose.
        """
        rows = np.ascontiguousarray(rows, np.int32)
        found: NDArray[np.float32] = backend.distances(
            *self._view, rows, poses, points, self.resolution_m, self.reach_cells, self.threads
        )
        return found

    def cast_rays(
        self, rows: Rows, poses: FloatArray, origin: FloatArray, directions: FloatArray, max_m: float
    ) -> NDArray[np.float32]:
        """Range in m (K, B) to the first occupied cell, from origin (2,) along directions (B, 2) of the base frame.

        `max_m` where there is none; directions have length 1; `rows` (K,): index of the map of each pose (K, 3).
        """
        rows = np.ascontiguousarray(rows, np.int32)
        found: NDArray[np.float32] = backend.cast_rays(
            *self._view, rows, poses, origin, directions, self.resolution_m, max_m, self.threads
        )
        return found

    def is_known(self, row: int, points: FloatArray) -> NDArray[np.bool_]:
        """Whether the cells of points (B, 2) of the world were observed, in one map."""
        roots, first, pages, log_odds, _ = self._view
        y, x = cells_of(points, self.resolution_m).T
        found: NDArray[np.bool_] = log_odds.reshape(-1)[cell_addresses(roots, first, pages, row, y, x)] != UNKNOWN
        return found

    def tiled(self, row: int) -> TiledGrid:
        """The map as a rectangle, cut to the tiles that hold something, that stays in them."""
        return TiledGrid(self, row)

    def occupancy(self, row: int) -> OccupancyGrid:
        """The map as such a rectangle, unfolded; a single unknown cell if no tile holds anything."""
        return self.tiled(row).whole()

    def field(self, row: int) -> tuple[NDArray[np.uint8], tuple[int, int]]:
        """The distance field (H, W) uint8 as such a rectangle, and the cell (row, column) that is its corner.

        255 at an occupied cell, falling with the distance to 0 at the field's reach.
        """
        ids, (tile_row, tile_column) = self.tile_ids(row)
        if not ids.any():
            return np.zeros((1, 1), np.uint8), (0, 0)
        blocks = self._arena.field[ids]
        return blocks.swapaxes(1, 2).reshape(len(blocks) * TILE, -1), (tile_row * TILE, tile_column * TILE)

    def tile_ids(self, row: int) -> tuple[Int32Array, tuple[int, int]]:
        """Ids (R, C) of the tiles of one map, 0 where there is none, and of their corner the (row, column) in tiles.

        They are cut to those that hold something; a single 0 at (0, 0) if there is none. Maps that have a tile in
        common have the same id there; a tile that one map has alone is written in place.
        """
        pages = self._arena.pages[self._roots[row]]  # (P, Q, PAGE, PAGE)
        ids = pages.swapaxes(1, 2).reshape(len(pages) * PAGE, -1)
        rows = np.flatnonzero(ids.any(axis=1))
        columns = np.flatnonzero(ids.any(axis=0))
        if not len(rows):
            return np.zeros((1, 1), np.int32), (0, 0)
        corner = self._first[0] * PAGE + int(rows[0]), self._first[1] * PAGE + int(columns[0])
        return ids[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1], corner

    def tiles(self, ids: Int32Array) -> NDArray[np.int16]:
        """Copies (K, 32, 32) of tiles by id (K,): log-odds in units of `LOG_ODDS_UNIT`; `UNKNOWN` where nothing is."""
        copies: NDArray[np.int16] = self._arena.log_odds[ids]
        return copies

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Plain arrays that hold the maps, each shared tile once; equal maps that share alike give equal arrays.

        Returns
        -------
        dict
            "roots" (rows, P, Q) int32: page ids; "first" (2,) int64: page row and column of their corner; "pages"
            (K, 16, 16) int32: tile ids; "log_odds" (T, 32, 32) int16; "field" (T, 32, 32) uint8. Ids count from 1 in
            order of appearance; page 0 and tile 0 are the empty ones.
        """
        roots, pages = renumber(self._roots)
        tables, tiles = renumber(self._arena.pages[pages])
        return {
            "roots": roots,
            "first": np.array(self._first, np.int64),
            "pages": tables,
            "log_odds": self._arena.log_odds[tiles],
            "field": self._arena.field[tiles],
        }

    @classmethod
    def from_arrays(
        cls,
        arrays: Mapping[str, NDArray[Any]],
        *,
        resolution_m: float,
        reach_cells: float,
        evidence: Evidence,
        threads: int = 1,
    ) -> TileMaps:
        """Maps from the arrays of `to_arrays`, over an arena of their own; they go on bit for bit as the others would.

        Raises
        ------
        ArgumentError
            An array is missing, has a wrong dtype or shape, or holds an id that is unknown or never used.
        """
        names = ("roots", "pages", "log_odds", "field")
        missing = {*names, "first"} - set(arrays)
        if missing:
            raise ArgumentError("arrays", f"the arrays {', '.join(names)} and first", f"none named {sorted(missing)}")
        first = np.asarray(arrays["first"])
        if first.shape != (2,) or first.dtype.kind != "i":
            raise ArgumentError("first", "two integers", f"{first.dtype} of shape {first.shape}")
        arena = TileArena.from_arrays(*(np.asarray(arrays[name]) for name in names))
        maps = cls(1, resolution_m=resolution_m, reach_cells=reach_cells, evidence=evidence, threads=threads)
        maps._arena = arena
        maps._roots = arrays["roots"].copy()
        maps._first = (int(first[0]), int(first[1]))
        return maps

    def _make_writable(self, tiles_to_write: Int32Array) -> None:
        arena = self._arena
        while True:
            pages, tiles, done = backend.make_tiles_writable(
                *self._view, arena.page_refs, arena.tile_refs, *arena.free_ids, tiles_to_write
            )
            arena.allocate(pages, tiles)
            if done == len(tiles_to_write):
                return
            tiles_to_write = tiles_to_write[done:]
            arena.grow()

    def _cover(self, poses: FloatArray, beams: BeamEnds) -> None:
        """Grow the tables until every cell that the scan can write lies inside."""
        reach_m = beams.reach_m + 2 * self.reach_m
        page_m = self.resolution_m * TILE * PAGE
        places = poses[:, 1::-1]  # [y, x]
        low = np.floor((places.min(axis=0) - reach_m) / page_m).astype(np.int64)
        high = np.floor((places.max(axis=0) + reach_m) / page_m).astype(np.int64) + 1
        begin = np.array(self._first)
        end = begin + self._roots.shape[1:]
        margins = np.stack([begin - np.minimum(begin, low), np.maximum(end, high) - end], axis=1)
        if margins.any():
            self._roots = np.pad(self._roots, [(0, 0), *margins.tolist()])
            row, column = (begin - margins[:, 0]).tolist()
            self._first = row, column
