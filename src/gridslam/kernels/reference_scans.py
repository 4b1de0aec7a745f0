"""The NumPy twins of the kernels that take many scans, each with a pose of its own.

They get the twins for a single scan that they are made of as their first argument.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from gridslam.kernels.reference_update import (
    PAGE,
    FloatArray,
    Int32Array,
    IntArray,
    LogOdds,
    make_tiles_writable,
    tiles_near_cells,
    tiles_on_rays,
    update_field,
    update_log_odds,
)

_ROW = np.zeros(1, np.int32)


def draw_scans(
    distances: Callable[..., NDArray[np.float32]],
    known_cells: Callable[..., NDArray[np.bool_]],
    roots: Int32Array,
    first: tuple[int, int],
    pages: Int32Array,
    log_odds: LogOdds,
    field: NDArray[np.uint8],
    page_refs: Int32Array,
    tile_refs: Int32Array,
    free_pages: Int32Array,
    free_tiles: Int32Array,
    poses: FloatArray,
    ends: FloatArray,
    starts: IntArray,
    origins: FloatArray,
    begin: int,
    end: int,
    resolution: float,
    steps: tuple[int, int, int, int, int],
    cone: NDArray[np.uint8],
    room: int,
    weighed_after: IntArray,
    weights: NDArray[np.float32],
    reach_cells: float,
    scale_m: float,
) -> tuple[int, int, int]:
    """Draw scans `begin` to `end` - 1 into map 0, one after the other, and weigh scans in between.

    What is occupied in the end alone decides the field, so the kernel updates it once, and before a scan is weighed.

    Parameters
    ----------
    page_refs, tile_refs, free_pages, free_tiles
        As for `make_tiles_writable`.
    poses, ends, starts, origins : (K, 3), (B, 2) float64, (K + 1,) int64, (K, 2) float64
        Scan k has ends starts[k] to starts[k + 1] - 1.
    steps, cone
        As for `update_log_odds` and `update_field`.
    room : int
        Tiles that may be taken.
    weighed_after : (L,) int64
        Scan k < L is weighed when this many >= 1 of the batch are drawn, ascending; those before `begin` are.
    weights : (B,) float32
        Takes the Cauchy weights of the beams that are weighed, -1 of those that end in unknown cells.
    reach_cells, scale_m : float
        Of `distances`, and at which one a beam weighs half.

    Returns
    -------
    (int, int, int)
        How many free pages and tiles were taken, and how many scans were drawn: those before the first one for which
        the free ones or the room might not suffice.
    """
    maps = roots, first, pages, log_odds, field
    pages_left, tiles_left = len(free_pages), len(free_tiles)
    done = begin

    def weigh_after(drawn: int) -> None:
        for seen in np.flatnonzero(weighed_after == drawn).tolist() if drawn else ():
            own = slice(starts[seen], starts[seen + 1])
            weights[own] = _weigh(
                distances, known_cells, maps, poses[seen], ends[own], resolution, reach_cells, scale_m
            )

    weigh_after(done)
    for scan in range(begin, end):
        beams = ends[starts[scan] : starts[scan + 1]]
        pose, origin = poses[scan : scan + 1], origins[scan]
        if len(beams):
            crossed = tiles_on_rays(_ROW, pose, beams, origin, resolution, 1)
            most_pages, most_tiles = _most_new(roots, first, pages, tile_refs, crossed)
            if most_pages > pages_left or most_tiles > min(tiles_left, room - (len(free_tiles) - tiles_left)):
                break
            changed: Int32Array | None = None
            for written in range(2):
                if changed is not None:
                    crossed = tiles_near_cells(changed, len(cone) // 2)
                spare = free_pages[:pages_left], free_tiles[:tiles_left]
                some, more, _ = make_tiles_writable(*maps, page_refs, tile_refs, *spare, crossed)
                pages_left, tiles_left = pages_left - some, tiles_left - more
                if not written:
                    changed = update_log_odds(*maps, _ROW, pose, beams, origin, resolution, *steps, 1)
            assert changed is not None
            if len(changed):
                update_field(*maps, changed, cone, 1)
        done = scan + 1
        weigh_after(done)
    return len(free_pages) - pages_left, len(free_tiles) - tiles_left, done - begin


def _most_new(
    roots: Int32Array, first: tuple[int, int], pages: Int32Array, tile_refs: Int32Array, crossed: Int32Array
) -> tuple[int, int]:
    """Pages and tiles at most that drawing a scan takes whose rays cross tiles (N, 3) of map 0."""
    if not len(crossed):
        return 0, 0
    about = {(y + dy, x + dx) for _, y, x in crossed.tolist() for dy in (-1, 0, 1) for dx in (-1, 0, 1)}
    y, x = np.array(sorted(about)).T
    row, column = y // PAGE - first[0], x // PAGE - first[1]
    inside = (row >= 0) & (column >= 0) & (row < roots.shape[1]) & (column < roots.shape[2])
    tile = np.zeros(len(y), np.int32)
    page = roots[0, row[inside], column[inside]]
    tile[inside] = pages[page, y[inside] % PAGE, x[inside] % PAGE]
    sides = [int(places.max()) // PAGE - int(places.min()) // PAGE + 1 for places in (y, x)]
    return sides[0] * sides[1], int(np.count_nonzero((tile == 0) | (tile_refs[tile] > 1)))


def _weigh(
    distances: Callable[..., NDArray[np.float32]],
    known_cells: Callable[..., NDArray[np.bool_]],
    maps: tuple[Int32Array, tuple[int, int], Int32Array, LogOdds, NDArray[np.uint8]],
    pose: FloatArray,
    ends: FloatArray,
    resolution: float,
    reach_cells: float,
    scale_m: float,
) -> NDArray[np.float32]:
    """Cauchy weights (B,) of the ends of a scan, -1 in unknown cells."""
    away = distances(*maps, _ROW, pose[None], ends, resolution, reach_cells, 1)[0]
    known = known_cells(*maps, 0, pose, ends, resolution)
    scaled = away / np.float32(scale_m)
    return np.where(known, 1 / (1 + scaled * scaled), np.float32(-1)).astype(np.float32)
