"""The NumPy twins of the compiled kernels: what each computes, readable; the oracle of their tests, and the fallback.

All functions but `max_pyramid`, `correlate` and `sum_at_ends`, which work on one plain array, work on maps of one
layout, five arguments that always come first:

roots : (R, P, Q) int32
    For each map (row) a table of page ids; ``roots[r, 0, 0]`` is the page at page coordinates `first`.
first : (int, int)
    Page row and page column of the table's corner; signed.
pages : (K, 16, 16) int32
    Tile ids; page 0 is empty.
log_odds : (T, 32, 32) int16
    In units of `gridslam.grid.LOG_ODDS_UNIT` nats, `UNKNOWN` where nothing is known; tile 0 is unknown all over.
field : (T, 32, 32) uint8
    255 at an occupied cell, falling with the distance to 0 at the field's reach; tile 0 is 0 all over.

A cell is [row y, column x] with cell (0, 0) at the world's origin, indices signed; what lies outside a table is empty.
Poses are ``[x m, y m, theta rad]``; `ends` and `origin` are points of the robot's base frame in m; `rows` is the index
of the map of each pose, each map at most once where the kernel writes. `threads` is for the compiled kernels alone.
"""

from __future__ import annotations

from gridslam.kernels.reference_correlate import correlate, max_pyramid
from gridslam.kernels.reference_likelihood import sum_at_ends
from gridslam.kernels.reference_lookup import cast_rays, distances, match
from gridslam.kernels.reference_update import (
    make_tiles_writable,
    tiles_near_cells,
    tiles_on_rays,
    update_field,
    update_log_odds,
)

__all__ = [
    "cast_rays",
    "correlate",
    "distances",
    "make_tiles_writable",
    "match",
    "max_pyramid",
    "sum_at_ends",
    "tiles_near_cells",
    "tiles_on_rays",
    "update_field",
    "update_log_odds",
]  # fmt: skip
