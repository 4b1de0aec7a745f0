"""NumPy twin of the kernel that inserts a scan into maps; see `gridslam.kernels.reference` for the maps' layout."""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from gridslam.kernels.reference_update import (
    FARTHEST,
    PAGE,
    TILE,
    FloatArray,
    Int32Array,
    LogOdds,
    make_tiles_writable,
    tiles_near_cells,
    tiles_on_rays,
    update_field,
    update_log_odds,
)

MOST_BEAM_CELLS = 21_000
"""Cells from the robot to the end of a beam, 1050 m in cells of 5 cm: with them all around, a scan spans 2^31 cells."""

OUTSIDE = -1
"""Return code: the tables do not cover the cells that a scan may write to."""

NO_ROOM = -2
"""A scan crosses more tiles than there is room for."""

Updated: TypeAlias = tuple[int, int, int, Int32Array, Int32Array]
"""The result of `update`."""


def update(
    roots: Int32Array,
    first: tuple[int, int],
    pages: Int32Array,
    log_odds: LogOdds,
    field: NDArray[np.uint8],
    page_refs: Int32Array,
    tile_refs: Int32Array,
    free_pages: Int32Array,
    free_tiles: Int32Array,
    pending: Int32Array,
    room: int,
    rows: Int32Array,
    poses: FloatArray,
    ends: FloatArray,
    origin: FloatArray,
    resolution: float,
    hit: int,
    miss: int,
    min: int,
    max: int,
    occupied_above: int,
    cone: NDArray[np.uint8],
    margin_m: float,
    threads: int,
) -> Updated:
    """Insert a scan into maps `rows` (K,), each once, and let their distance fields follow: see `update_log_odds`.

    What is written to becomes its map's own first. Where free ids do not suffice the caller makes more and goes on with
    the maps that are left, and with what is pending.

    Parameters
    ----------
    pending : (M, 4) int32
        Changed cells whose field is still the old one, left by the call before.
    room : int
        Tiles that may be crossed by all rays together; any number where it is negative.
    margin_m : float
        How far beyond the ends of beams the tables must reach.

    Returns
    -------
    (int, int, int, (L,) int32, (M, 4) int32)
        0, or `OUTSIDE` or `NO_ROOM`, and then no map was written; how many free pages and tiles were taken; places in
        `rows` of the maps that were not written; what is pending.
    """
    view = roots, first, pages, log_odds, field
    taken = [0, 0]

    def own(tiles_to_write: Int32Array) -> bool:
        ids = free_pages[: len(free_pages) - taken[0]], free_tiles[: len(free_tiles) - taken[1]]
        *used, done = make_tiles_writable(*view, page_refs, tile_refs, *ids, tiles_to_write)
        taken[0] += used[0]
        taken[1] += used[1]
        return done == len(tiles_to_write)

    def result(status: int, left: Int32Array, pending: Int32Array) -> Updated:
        return status, taken[0], taken[1], left, pending

    reach = len(cone) // 2
    none, everything = pending[:0], np.arange(len(rows), dtype=np.int32)
    if len(pending):
        if not own(tiles_near_cells(pending, reach)):
            return result(0, everything, pending)
        update_field(*view, pending, cone, threads)
    if not len(rows):
        return result(0, everything, none)
    if not _covers(roots.shape, first, poses, ends, origin, resolution, margin_m):
        return result(OUTSIDE, everything, none)
    crossed = tiles_on_rays(rows, poses, ends, origin, resolution, threads)
    if 0 <= room < len(crossed):
        return result(NO_ROOM, everything, none)
    if not own(crossed):
        return result(0, everything, none)
    changed = update_log_odds(
        *view, rows, poses, ends, origin, resolution, hit, miss, min, max, occupied_above, threads
    )
    if not len(changed) or own(tiles_near_cells(changed, reach)):
        update_field(*view, changed, cone, threads)
        changed = none
    return result(0, everything[:0], changed)


def _covers(
    shape: tuple[int, ...],
    first: tuple[int, int],
    poses: FloatArray,
    ends: FloatArray,
    origin: FloatArray,
    resolution: float,
    margin_m: float,
) -> bool:
    """Return whether tables of this shape cover all cells that the scan can write to; False if not finite."""
    reach_m = math.sqrt((ends**2).sum(axis=1).max(initial=float(origin @ origin)))
    if not (reach_m <= MOST_BEAM_CELLS * resolution * (1 + 1e-9) and np.isfinite(poses).all()):
        return False
    around = reach_m + margin_m - 1e-6  # rounding must not ask for more than the caller gives
    low = poses[:, 1::-1].min(axis=0) - around
    high = poses[:, 1::-1].max(axis=0) + around
    page_m = resolution * PAGE * TILE
    begin = np.array(first)
    inside = (low >= -FARTHEST * resolution) & (high <= FARTHEST * resolution)
    inside &= (np.floor(low / page_m) >= begin) & (np.floor(high / page_m) < begin + shape[1:3])
    return bool(inside.all())
