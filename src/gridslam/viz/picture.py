"""Picture of the map: known cells, trajectory of the robot, a scale, and a caption."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from gridslam.types import FloatArray, GridRows, Trajectory
from gridslam.viz.footer import paint_footer
from gridslam.viz.layout import Layout, lay_out
from gridslam.viz.palette import CLOSURE, FREE, OCCUPIED, TIME_ENDS, TRUTH, UNKNOWN, Colour, time_colours
from gridslam.viz.strokes import disc, stroke

__all__ = ["draw_map"]

_NODE_PX = 3.0  # a path is thinned to nodes this far apart
_ROWS = 64  # cells are turned to bytes this many rows at a time
_LEVELS_PER_NAT, _EVEN = 32, 128  # log-odds as a byte: 128 is even odds, also for an unknown cell


def _ramp(first: int, last: int) -> list[int]:
    """Table of 256 levels that rises (or falls) from 0 at `first` to 255 at `last`."""
    return [round(255 * min(max((level - first) / (last - first), 0.0), 1.0)) for level in range(256)]


_OCCUPIED_LEVELS = _ramp(_EVEN, _EVEN + 40)  # fully dark from a probability of 0.78 on
_FREE_LEVELS = [max(a, b) for a, b in zip(_ramp(_EVEN, _EVEN - 24), _ramp(_EVEN, _EVEN + 8), strict=True)]
_CRISP = _ramp(52, 204)  # sharpens an enlarged edge to about half a cell


def draw_map(
    grid: GridRows,
    trajectory: Trajectory | None = None,
    *,
    title: str = "",
    caption: Sequence[str] = (),
    truth: Trajectory | None = None,
    walls: FloatArray | None = None,
    closures: FloatArray | None = None,
) -> Image.Image:
    """Draw the known part of a map with the trajectory over it, a scale bar and a caption under it.

    Parameters
    ----------
    grid : OccupancyGrid, or another that gives rows
    trajectory : Trajectory, optional
        In the frame of the grid; coloured by time, with its start (white) and end (filled) marked.
    title : str
        First line of the caption, in larger letters.
    caption : sequence of str
        Further lines.
    truth : Trajectory, optional
        The true trajectory in the frame of the grid, drawn under the other.
    walls : (S, 4) float64, m, optional
        A floor plan in the frame of the grid, drawn in the colour of the truth.
    closures : (K, 4) float64, m, optional
        Loop closures as [x0, y0, x1, y1], the two places that each of them joins, in the frame of the grid.

    Returns
    -------
    PIL.Image.Image
        RGB, its long side about 1400 to 4000 px.
    """
    layout = lay_out(grid, title, caption)
    page = Image.new("RGB", layout.size, UNKNOWN)
    _paint_cells(page, grid, layout)
    _paint_truth(page, truth, walls, layout)
    if trajectory is not None and len(trajectory):
        _paint_trajectory(page, trajectory, layout)
    keys = [("truth", TRUTH)] if truth is not None or walls is not None else []
    if closures is not None and len(closures):
        _paint_closures(page, closures, layout)
        keys.append(("loop closures", CLOSURE))
    paint_footer(page, layout, title, caption, trajectory, keys)
    return page


def _paint_cells(page: Image.Image, grid: GridRows, layout: Layout) -> None:
    """Blend FREE and then OCCUPIED into the page, each through a mask of how much a cell is so."""
    for colour, table in ((FREE, _FREE_LEVELS), (OCCUPIED, _OCCUPIED_LEVELS)):
        _blend(page, colour, _levels(grid, layout, np.array(table, np.uint8)), layout)


def _blend(page: Image.Image, colour: Colour, cells: NDArray[np.uint8], layout: Layout) -> None:
    """Blend one colour into the page, through cells (H, W) enlarged or reduced to the map's box."""
    if not cells.size:
        return
    left, top, right, bottom = layout.map_box
    size = (right - left, bottom - top)
    larger = size[0] > cells.shape[1]
    mask = Image.fromarray(cells).resize(size, Image.Resampling.BICUBIC if larger else Image.Resampling.BOX)
    page.paste(colour, layout.map_box, mask.point(_CRISP) if larger else mask)


def _levels(grid: GridRows, layout: Layout, table: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Log-odds of the cells shown, as bytes and by `table`, the uppermost row first."""
    below, columns = layout.rows.start, layout.columns
    height = min(layout.rows.stop, grid.shape[0]) - below
    levels = np.empty((height, min(columns.stop, grid.shape[1]) - columns.start), np.uint8)
    for first in range(0, height, _ROWS):
        last = min(first + _ROWS, height)
        band = grid.rows(below + first, below + last)
        log_odds, shown = band.log_odds[:, columns], np.full((last - first, levels.shape[1]), _EVEN, np.uint8)
        scaled = np.clip(log_odds * _LEVELS_PER_NAT + _EVEN, 0, 255)
        np.copyto(shown, scaled, where=band.known[:, columns], casting="unsafe")
        levels[height - last : height - first] = table[shown][::-1]
    return levels


def _path(trajectory: Trajectory, layout: Layout) -> tuple[FloatArray, FloatArray]:
    """Segments (K, 4) of a path in px, thinned, and when each of them ends, as a share (K,) of the whole time."""
    points = layout.pixels(trajectory.poses[:, :2])
    steps = np.hypot(*np.diff(points, axis=0).T)
    walked = np.concatenate([[0.0], np.cumsum(steps)]) // _NODE_PX
    kept = np.union1d(np.flatnonzero(np.diff(walked, prepend=-1.0)), len(points) - 1)
    passed = np.maximum.accumulate(trajectory.stamps_ns - trajectory.stamps_ns[0]).astype(np.float64)
    nodes = points[kept]
    return np.concatenate([nodes[:-1], nodes[1:]], axis=1), passed[kept[1:]] / max(passed[-1], 1.0)


def _paint_truth(page: Image.Image, truth: Trajectory | None, walls: FloatArray | None, layout: Layout) -> None:
    if walls is not None and len(walls):
        ends = layout.pixels(walls.reshape(-1, 2)).reshape(-1, 4)
        stroke(page, ends, [TRUTH] * len(ends), 1.2 * layout.unit)
    if truth is not None and len(truth):
        ends, _ = _path(truth, layout)
        stroke(page, ends, [TRUTH] * len(ends), 2.0 * layout.unit)


def _paint_closures(page: Image.Image, closures: FloatArray, layout: Layout) -> None:
    points = layout.pixels(closures.reshape(-1, 2))
    stroke(page, points.reshape(-1, 4), [CLOSURE] * len(closures), 1.5 * layout.unit)
    stroke(page, np.tile(points, 2), [CLOSURE] * len(points), 5.0 * layout.unit)  # a dot at each end


def _paint_trajectory(page: Image.Image, trajectory: Trajectory, layout: Layout) -> None:
    segments, shares = _path(trajectory, layout)
    stroke(page, segments, time_colours(shares), 3.0 * layout.unit)
    (start, end), (first, last) = layout.pixels(trajectory.poses[[0, -1], :2]).tolist(), TIME_ENDS
    disc(page, start, 8.0 * layout.unit, FREE, first)
    disc(page, end, 8.0 * layout.unit, last, OCCUPIED)
