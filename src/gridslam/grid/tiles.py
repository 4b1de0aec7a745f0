"""Copy-on-write tiled maps: one map for each particle, at the cost of the tiles in which it differs from the others."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from functools import lru_cache
from typing import Annotated, Any, final

import numpy as np
from numpy.typing import NDArray

from gridslam.arguments import Limits, index_of
from gridslam.checked import checked
from gridslam.errors import ArgumentError
from gridslam.geometry.single_pose import Information, Pose
from gridslam.grid.arena import TileArena, renumber
from gridslam.grid.cells import LOG_ODDS_UNIT, Evidence, cell_corner
from gridslam.kernels import FARTHEST, MOST_BEAM_CELLS, NO_ROOM, OUTSIDE, PAGE, TILE, UNKNOWN, backend
from gridslam.kernels.reference_maps import Updated
from gridslam.kernels.reference_update import unknown_of
from gridslam.types import BeamEnds, FloatArray, Int32Array, IntArray, OccupancyGrid, Points, Poses, Rows

MOST_CELLS = 2**31
"""Cells of the rectangle that all maps of a table may span, 2.3 km x 2.3 km in cells of 5 cm: an image of 2.1 GB."""

MOST_TILES = 500_000
"""Tiles of all maps together where nothing else is asked for: 1 GB, or 1.5 (`Evidence.byte_unit`)."""

_ORIGIN = np.zeros(3)
_PAGE_CELLS = PAGE * TILE
_RowNumbers = Annotated[Rows, "K", index_of("self")]
_Row = Annotated[int, index_of("self")]
_Side = Annotated[int, Limits(TILE, 2**16)]
_NOTHING_PENDING = np.zeros((0, 4), np.int32)
_MOST_ENTRIES = 2**24  # of the tables of all maps together: 67 MB


@final
class TiledGrid:
    """One map of `TileMaps`, cut to the tiles that hold something; a single unknown cell if there are none.

    What is written to the map later does not change it. Tiles take 2 or 3 bytes a cell, and only where something is
    known; unfolded as an `OccupancyGrid` the whole rectangle takes 5: 210 MB for 460 m x 230 m in cells of 5 cm.

    Attributes
    ----------
    shape : (int, int)
        Rows and columns of cells.
    resolution_m : float
        Side of a cell.
    origin : (float, float), m
        World coordinates of the lower left corner of cell [0, 0].
    """

    __slots__ = ("_maps", "origin", "resolution_m", "shape")

    def __init__(self, maps: TileMaps, row: int) -> None:
        """Take map `row` as it is now."""
        self._maps = maps.snapshot(np.array([row]))
        ids, (tile_row, tile_column) = maps.tile_ids(row)
        self.shape = (len(ids) * TILE, ids.shape[1] * TILE) if ids.any() else (1, 1)
        self.resolution_m = maps.resolution_m
        self.origin = cell_corner(tile_row * TILE, tile_column * TILE, maps.resolution_m)

    def rows(self, first: int, last: int) -> OccupancyGrid:
        """Unfold rows `first` to `last` - 1."""
        ids, (tile_row, tile_column) = self._maps.tile_ids(0)
        ids = ids[first // TILE : -(-last // TILE)]
        log_odds = np.zeros((len(ids) * TILE, ids.shape[1] * TILE), np.float32)
        known = np.zeros(log_odds.shape, np.bool_)
        for number, strip_ids in enumerate(ids):
            strip = slice(number * TILE, (number + 1) * TILE)
            cells = self._maps.tiles(strip_ids).swapaxes(0, 1).reshape(TILE, -1)
            np.not_equal(cells, UNKNOWN, out=known[strip])
            log_odds[strip] = np.where(known[strip], cells, 0)
            log_odds[strip] *= LOG_ODDS_UNIT
        part = slice(first % TILE, first % TILE + last - first), slice(self.shape[1])
        corner = cell_corner(tile_row * TILE + first, tile_column * TILE, self.resolution_m)
        return OccupancyGrid(log_odds[part], known[part], self.resolution_m, corner)

    def whole(self) -> OccupancyGrid:
        """Unfold all of it."""
        return self.rows(0, self.shape[0])


@lru_cache(8)
def _make_cone(reach_cells: float) -> NDArray[np.uint8]:
    """Return the field about one obstacle, (2 r + 1, 2 r + 1) cells with r the whole part of its reach."""
    r = int(reach_cells)
    apart = np.hypot(*np.mgrid[-r : r + 1, -r : r + 1])
    return np.asarray(np.rint(255 * np.maximum(0, 1 - apart / reach_cells)), np.uint8)


@final
@checked
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
    most_tiles : int
        Tiles, of 2 or 3 KB each, beyond which all maps over the arena together do not grow, but for those about the
        ends of the last scan.

    Raises
    ------
    ArgumentError
        An argument is out of range. From `update`, before anything is written: a pose is not finite or more than 2^30
        cells from the world's origin, a beam ends more than `MOST_BEAM_CELLS` from the robot, the maps would span more
        than `MOST_CELLS`, or need more tiles than there may be.
    """

    __slots__ = (
        "_arena",
        "_cone",
        "_first",
        "_roots",
        "evidence",
        "most_tiles",
        "reach_cells",
        "resolution_m",
        "threads",
    )

    def __init__(
        self,
        rows: int,
        *,
        resolution_m: float,
        reach_cells: float,
        evidence: Evidence,
        threads: int = 1,
        most_tiles: int = MOST_TILES,
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
        self.most_tiles = most_tiles
        self._arena = TileArena(evidence.byte_unit)
        self._roots: Int32Array = np.zeros((rows, 1, 1), np.int32)
        self._first = (0, 0)
        self._cone = _make_cone(reach_cells)

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

    def tiles_of(self, rows: _RowNumbers) -> int:
        """Return number of tiles that maps `rows` (K,) use together."""
        return self._arena.tiles_of(self._roots[rows])

    @property
    def nbytes(self) -> int:
        """Bytes held by the arena and this table."""
        return self._arena.nbytes + self._roots.nbytes

    @property
    def _view(self) -> tuple[Any, ...]:
        arena = self._arena
        return self._roots, self._first, arena.pages, arena.log_odds, arena.field

    @property
    def _steps(self) -> tuple[int, ...]:
        """The evidence in the arena's unit."""
        return tuple(step // self._arena.unit for step in self.evidence.steps)

    def snapshot(self, rows: _RowNumbers | None = None) -> TileMaps:
        """Another owner of all maps or of maps `rows` (K,), at the cost of their tables.

        Tiles are copied when either side writes.
        """
        arena = self._arena
        roots = self._roots.copy() if rows is None else self._roots[rows]
        arena.retain(roots)  # before there is an owner who gives them back, should this fail
        twin = object.__new__(TileMaps)
        for name in TileMaps.__slots__:
            setattr(twin, name, getattr(self, name))
        twin._roots = roots
        return twin

    def shares_tiles(self, other: TileMaps) -> bool:
        """Return whether ids of tiles mean the same in both."""
        return self._arena is other._arena

    def copy(self) -> TileMaps:
        """Return all maps in memory of their own, which another thread may use."""
        arena = copy.deepcopy(self._arena)
        twin = copy.copy(self)
        twin._arena, twin._roots = arena, self._roots.copy()
        return twin

    def select(self, parents: Annotated[Rows, "M", index_of("self")]) -> None:
        """Replace map i by the old map parents[i]; parents (M,) int64."""
        arena = self._arena
        roots = self._roots[parents]
        arena.retain(roots)
        arena.release(self._roots)
        self._roots = roots

    def compact(self) -> None:
        """Release memory that no map uses; ids of tiles change, and maps stay independent of each other."""
        self._arena.compact()

    def clear(self, row: _Row) -> None:
        """Empty one map."""
        self._arena.release(self._roots[row])
        self._roots[row] = 0

    def update(self, rows: _RowNumbers, poses: Poses, beams: BeamEnds) -> None:
        """Insert a scan into maps `rows` (K,) int32, each at most once, at poses (K, 3): the binary Bayes filter.

        The cell at a beam's end is hit once for each beam, the cells before it are missed once for each, the first 1664
        of them (`gridslam.kernels.FREE_CELLS`); a cell in which some beam of the scan ends is not missed by it. The
        distance field follows. What is raised, and when: see the class.

        Source: Probabilistic Robotics, Table 9.1.
        """
        if not len(beams):
            return
        room = self.most_tiles - self.tiles_used
        status = self._insert(rows, poses, beams, room)
        if status == OUTSIDE:
            self._cover(poses, beams)
            status = self._insert(rows, poses, beams, room)
        if status == NO_ROOM:
            self._require_room(
                backend.tiles_on_rays(rows, poses, beams.ends, beams.origin, self.resolution_m, self.threads)
            )
            self._insert(rows, poses, beams, -1)

    def _insert(self, rows: Rows, poses: FloatArray, beams: BeamEnds, room: int) -> int:
        """Insert a scan, and make more ids where they do not suffice; OUTSIDE or NO_ROOM if nothing was written."""
        arena = self._arena
        scan = beams.ends, beams.origin, self.resolution_m, *self._steps, self._cone, 2 * self.reach_m, self.threads
        pending = _NOTHING_PENDING
        while True:
            ids = arena.page_refs, arena.tile_refs, *arena.free_ids
            updated: Updated = backend.update(*self._view, *ids, pending, room, rows, poses, *scan)
            status, pages, tiles, left, pending = updated
            arena.allocate(pages, tiles)
            if status or not (len(left) or len(pending)):
                return status
            rows, poses, room = rows[left], poses[left], -1
            arena.grow()

    def limit(self, log_odds: float) -> None:
        """Limit the log-odds of all known cells of all maps to `log_odds` nats, so that less evidence can change them.

        What is known stays known, and what is an obstacle remains one: the limit is above `Evidence.occupied_above`.
        ArgumentError where it is not.
        """
        steps = round(log_odds / LOG_ODDS_UNIT)
        if steps <= self.evidence.occupied_above:
            expected = f"more than {self.evidence.occupied_above * LOG_ODDS_UNIT:g} nats, of an obstacle"
            raise ArgumentError("log_odds", expected, log_odds)
        if steps % self._arena.unit:
            self._arena.widen()
        steps //= self._arena.unit
        unknown = unknown_of(self._arena.log_odds)
        for row in range(len(self)):
            ids, (tile_row, tile_column) = self.tile_ids(row)
            places = np.argwhere(ids)
            cells = self._arena.log_odds[ids[tuple(places.T)]]
            places = places[((np.abs(cells) > steps) & (cells != unknown)).any(axis=(1, 2))]
            if not len(places):
                continue
            whole = np.insert(places + np.array([tile_row, tile_column]), 0, row, axis=1).astype(np.int32)
            self._require_room(whole)
            self._make_writable(whole)
            own = self.tile_ids(row)[0][tuple(places.T)]
            cells = self._arena.log_odds[own]
            limited = np.clip(cells, -steps, steps)
            self._arena.log_odds[own] = np.where(cells == unknown, cells, limited)

    def match(
        self,
        rows: _RowNumbers,
        guesses: Poses,
        priors: Annotated[FloatArray, "K", 3, 3],
        ends: Points,
        *settings: float | bool,
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Gauss-Newton from guesses (K, 3) with prior information (K, 3, 3); see `gridslam.matching.GaussNewton`."""
        found: tuple[FloatArray, FloatArray, FloatArray] = backend.match(
            *self._view, rows, guesses, priors, ends, self.resolution_m, *settings, self.threads
        )
        return found

    def match_pose(
        self, row: _Row, guess: Pose, prior: Information, ends: Points, thin_m: float, *settings: float | bool
    ) -> tuple[Pose, Information, float, float]:
        """`match` of one guess to map `row`, by numbers; see `gridslam.matching.gauss_newton.PoseMatch`."""
        found: tuple[Pose, Information, float, float] = backend.match_pose(
            *self._view, row, guess, prior, ends, thin_m, self.resolution_m, *settings
        )
        return found

    def distances(self, rows: _RowNumbers, poses: Poses, points: Points) -> NDArray[np.float32]:
        """Distance in m (K, B) from points (B, 2) of the base frame at poses (K, 3) to the nearest obstacle's centre.

        Capped at `reach_m`; `rows` (K,): index of the map of each pose.
        """
        rows = np.ascontiguousarray(rows, np.int32)
        settings = self.resolution_m, self.reach_cells, self.threads
        return np.asarray(backend.distances(*self._view, rows, poses, points, *settings), np.float32)

    def cast_rays(
        self, rows: _RowNumbers, poses: Poses, origin: Annotated[FloatArray, 2], directions: Points, max_m: float
    ) -> NDArray[np.float32]:
        """Range in m (K, B) to the first occupied cell, from origin (2,) along directions (B, 2) of the base frame.

        `max_m` where there is none; directions have length 1; `rows` (K,): index of the map of each pose (K, 3).
        """
        rows = np.ascontiguousarray(rows, np.int32)
        found: NDArray[np.float32] = backend.cast_rays(
            *self._view, rows, poses, origin, directions, self.resolution_m, max_m, self.threads
        )
        return found

    def is_known(self, row: _Row, points: Points, pose: Annotated[FloatArray, 3] = _ORIGIN) -> NDArray[np.bool_]:
        """Return whether the cells (B,) of points (B, 2), seen from a pose (3,), were observed, in one map."""
        return np.asarray(backend.known_cells(*self._view, row, pose, points, self.resolution_m), np.bool_)

    def tiled(self, row: _Row) -> TiledGrid:
        """Return the map as a rectangle, cut to the tiles that hold something, that stays in them."""
        return TiledGrid(self, row)

    def occupancy(self, row: _Row) -> OccupancyGrid:
        """Return the map as such a rectangle, unfolded; a single unknown cell if no tile holds anything."""
        return self.tiled(row).whole()

    def field(self, row: _Row, most_cells: _Side = 2**13) -> tuple[NDArray[np.uint8], tuple[int, int]]:
        """Return the distance field (H, W) uint8 as such a rectangle, and the cell (row, column) that is its corner.

        255 at an occupied cell, falling with the distance to 0 at the field's reach. A rectangle of more cells than a
        square of `most_cells` a side, 410 m in cells of 5 cm, is cut to such a square, about the median of the tiles
        that hold something.
        """
        tiles, ids, corner = self.field_tiles(row, most_cells)
        if not ids.any():
            return np.zeros((1, 1), np.uint8), (0, 0)
        return tiles[ids].swapaxes(1, 2).reshape(len(ids) * TILE, -1), corner

    def field_tiles(
        self, row: _Row, most_cells: _Side = 2**13
    ) -> tuple[NDArray[np.uint8], Int32Array, tuple[int, int]]:
        """The same unfolded: all maps' tiles (T, 32, 32) of it, the ids (R, C) of the rectangle's, and its corner.

        The tiles are those that the maps go on with.
        """
        ids, (tile_row, tile_column) = self.tile_ids(row)
        side = most_cells // TILE
        if ids.size > side**2:
            middle = np.median(np.argwhere(ids), axis=0).astype(np.int64)
            top, left = np.clip(middle - side // 2, 0, np.maximum(np.array(ids.shape) - side, 0)).tolist()
            ids = ids[top : top + side, left : left + side]
            tile_row += top
            tile_column += left
        return self._arena.field, np.ascontiguousarray(ids), (tile_row * TILE, tile_column * TILE)

    def tile_ids(self, row: _Row) -> tuple[Int32Array, tuple[int, int]]:
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

    def tiles(self, ids: Annotated[IntArray | Int32Array, "K"]) -> NDArray[np.int16]:
        """Copies (K, 32, 32) of tiles by id (K,): log-odds in units of `LOG_ODDS_UNIT`; `UNKNOWN` where nothing is."""
        return self._arena.steps_of(ids)

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Return plain arrays that hold the maps, each shared tile once; equal maps that share alike give equal arrays.

        Returns
        -------
        dict
            "roots" (rows, P, Q) int32: page ids; "first" (2,) int64: page row and column of their corner; "pages"
            (K, 16, 16) int32: tile ids; "log_odds" (T, 32, 32) int16; "field" (T, 32, 32) uint8. Ids count from 1 in
            order of appearance; page 0 and tile 0 are the empty ones.
        """
        arena = self._arena
        roots, pages = renumber(self._roots)
        tables, tiles = renumber(arena.pages[pages])
        return {
            "roots": roots,
            "first": np.array(self._first, np.int64),
            "pages": tables,
            "log_odds": arena.steps_of(tiles),
            "field": arena.field[tiles],
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
        most_tiles: int = MOST_TILES,
    ) -> TileMaps:
        """Restore maps from the arrays of `to_arrays`, over an arena of their own; later updates are bit-identical.

        Raises
        ------
        ArgumentError
            An array is missing, has a wrong dtype or shape, holds an id that is unknown or never used, or a map lies
            farther from the world's origin than any can.
        """
        names = ("roots", "pages", "log_odds", "field")
        missing = {*names, "first"} - set(arrays)
        if missing:
            raise ArgumentError("arrays", f"the arrays {', '.join(names)} and first", f"none named {sorted(missing)}")
        first = np.asarray(arrays["first"])
        if first.shape != (2,) or first.dtype.kind != "i":
            raise ArgumentError("first", "two integers", f"{first.dtype} of shape {first.shape}")
        roots, pages, log_odds, field = (np.asarray(arrays[name]) for name in names)
        arena = TileArena.from_arrays(roots, pages, log_odds, field, evidence.byte_unit)
        corners = [int(first[0]), int(first[1])]
        ends = [corner + side for corner, side in zip(corners, roots.shape[1:], strict=True)]
        farthest = FARTHEST // _PAGE_CELLS
        if min(corners) < -farthest or max(ends) > farthest:
            raise ArgumentError("first", f"a table within {farthest} pages of the world's origin", corners)
        maps = cls(
            1,
            resolution_m=resolution_m,
            reach_cells=reach_cells,
            evidence=evidence,
            threads=threads,
            most_tiles=most_tiles,
        )
        maps._arena = arena
        maps._roots = roots.copy()
        maps._first = (corners[0], corners[1])
        return maps

    def _require_room(self, tiles_to_write: Int32Array) -> None:
        """Raise ArgumentError where making tiles (N, 3) = [row, tile y, tile x] writable takes more than there may be.

        Those count that are empty, or that another map uses, too.
        """
        arena = self._arena
        row, y, x = tiles_to_write.T
        page = self._roots[row, y // PAGE - self._first[0], x // PAGE - self._first[1]]
        tile = arena.pages[page, y % PAGE, x % PAGE]
        is_new = (tile == 0) | (arena.tile_refs[tile] > 1) | (arena.page_refs[page] > 1)
        needed = self.tiles_used + int(np.count_nonzero(is_new))
        if needed > self.most_tiles:
            tile_bytes = arena.log_odds[0].nbytes + arena.field[0].nbytes
            size = f"{self.most_tiles} tiles, {1e-9 * self.most_tiles * tile_bytes:.2g} GB"
            expected = (
                f"at most {size} for all particles (mapper.max_tiles; larger cells and fewer particles need less)"
            )
            raise ArgumentError("maps", expected, needed)

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
        """Extend the tables to every cell that the scan can write; raises ArgumentError where that is impossible."""
        reach_m = beams.reach_m
        if not reach_m <= MOST_BEAM_CELLS * self.resolution_m:
            limit = f"ends within {MOST_BEAM_CELLS * self.resolution_m:g} m, {MOST_BEAM_CELLS} cells, of the robot"
            raise ArgumentError("beams", limit, f"{reach_m:g} m")
        reach_m += 2 * self.reach_m
        places = poses[:, 1::-1]  # [y, x]
        low_m = places.min(axis=0) - reach_m
        high_m = places.max(axis=0) + reach_m
        limit_m = FARTHEST * self.resolution_m
        if not (low_m.min() >= -limit_m and high_m.max() <= limit_m and np.isfinite(poses[:, 2]).all()):
            expected = f"finite poses within {limit_m:.3g} m of the world's origin"
            raise ArgumentError("poses", expected, f"{poses[np.abs(poses).max(axis=1).argmax()].tolist()}")
        page_m = self.resolution_m * _PAGE_CELLS
        low = np.floor(low_m / page_m).astype(np.int64)
        high = np.floor(high_m / page_m).astype(np.int64) + 1
        begin = np.array(self._first)
        if (low < begin).any() or (high > begin + self._roots.shape[1:]).any():
            self._extend(low, high)

    def _extend(self, low: IntArray, high: IntArray) -> None:
        """Lay out the tables again, over the pages in use and those from `low` (2,) to `high` - 1, [row, column]."""
        begin = np.array(self._first)
        used = np.argwhere(self._roots.any(axis=0))
        if len(used):
            low = np.minimum(low, begin + used.min(axis=0))
            high = np.maximum(high, begin + used.max(axis=0) + 1)
        rows, columns = (high - low).tolist()
        most = min(MOST_CELLS, _MOST_ENTRIES // len(self._roots) * _PAGE_CELLS**2)
        if rows * columns * _PAGE_CELLS**2 > most:
            page_m = self.resolution_m * _PAGE_CELLS
            got = f"{columns * page_m:.0f} m x {rows * page_m:.0f} m in cells of {self.resolution_m:g} m"
            raise ArgumentError("poses", f"places whose maps span at most {most:.1e} cells", got)
        roots = np.zeros((len(self._roots), rows, columns), np.int32)
        if len(used):
            (top, left), (bottom, right) = used.min(axis=0).tolist(), (used.max(axis=0) + 1).tolist()
            y, x = (begin - low).tolist()
            roots[:, y + top : y + bottom, x + left : x + right] = self._roots[:, top:bottom, left:right]
        row, column = low.tolist()
        self._roots = roots
        self._first = row, column
