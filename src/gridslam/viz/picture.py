"""Pictures of the plane: a map, a localization in it, landmarks; each with the robot's path, a scale and a caption."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import cycle

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from gridslam.types import FloatArray, GridRows, OccupancyGrid, Trajectory
from gridslam.viz.canvas import (
    CLOSURE,
    FAINT,
    FREE,
    LOST,
    OCCUPIED,
    TIME_ENDS,
    TRUTH,
    UNKNOWN,
    Colour,
    Layout,
    disc,
    dots,
    label_time,
    mark_ends,
    open_page,
    paint_footer,
    paint_path,
    stroke,
)

_MAP_SIDE_PX = (1300, 3200)  # the map's long side; with margins and footer the page is 1400 to 4000
_MAP_AREA_PX = 7_000_000  # Pillow keeps 4 bytes a pixel: a page of 30 MB
_CELL_PX = 64  # cells are not enlarged further
_ROWS = 64  # rows of cells looked at, or turned to bytes, at a time
_LEVELS_PER_NAT = 32  # of log-odds as a byte
_EVEN = 128  # even odds, also for an unknown cell

_CORNERS = 48  # of an ellipse
SIGMAS = 3.0
"""Ellipses are drawn at this many standard deviations: they contain the landmark with 98.9 %."""

_JUMP_M = 1.0  # a longer step of a localized robot is no way that was driven
_SPOT_PX = 3.0  # poses of a lost robot that are no farther apart are one dot


def _ramp(first: int, last: int) -> list[int]:
    """Table of 256 levels that rises (or falls) from 0 at `first` to 255 at `last`."""
    return [round(255 * min(max((level - first) / (last - first), 0.0), 1.0)) for level in range(256)]


_OCCUPIED_LEVELS = _ramp(_EVEN, _EVEN + 40)  # fully dark from a probability of 0.78 on
_FREE_LEVELS = [max(a, b) for a, b in zip(_ramp(_EVEN, _EVEN - 24), _ramp(_EVEN, _EVEN + 8), strict=True)]
_CRISP = _ramp(52, 204)  # sharpens an enlarged edge to about half a cell


# Of several drives, each in one colour, mostly after Okabe and Ito, so that they differ for every eye; no blue, which
# is that of loop closures.
_DRIVES: tuple[Colour, ...] = (
    (213, 94, 0), (0, 158, 115), (136, 34, 136), (230, 159, 0), (128, 90, 50), (204, 121, 167), (60, 60, 110)
)  # fmt: skip
_MOST_KEYS = 7  # of drives


def draw_map(
    grid: GridRows,
    trajectory: Trajectory | Mapping[str, Trajectory] | None = None,
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
    trajectory : Trajectory, or a mapping of str to Trajectory, optional
        In the frame of the grid; coloured by time, with its start (white) and end (filled) marked. Of several, by the
        names of their drives, each has a colour of its own.
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
    page = _paint_cells(grid, layout)
    keys: list[tuple[str, Colour]] = []
    ends: tuple[str, str] | None = None
    if truth is not None or walls is not None:
        keys.append(("truth", TRUTH))
    if walls is not None:
        stroke(page, layout.pixels(walls.reshape(-1, 2)).reshape(-1, 4), TRUTH, 1.2 * layout.unit)
    if truth is not None:
        paint_path(page, layout, truth, 2.0, TRUTH)
    if isinstance(trajectory, Mapping):
        keys += _paint_drives(page, layout, trajectory)
    elif trajectory is not None and len(trajectory):
        paint_path(page, layout, trajectory, 3.0)
        mark_ends(page, layout.pixels(trajectory.poses[[0, -1], :2]), 8.0 * layout.unit)
        ends = label_time(trajectory)
    if closures is not None and len(closures):
        points = layout.pixels(closures.reshape(-1, 2))
        stroke(page, points.reshape(-1, 4), CLOSURE, 1.5 * layout.unit)
        dots(page, points, CLOSURE, 5.0 * layout.unit)
        keys.append(("loop closures", CLOSURE))
    paint_footer(page, layout, title, caption, keys, ends)
    return page


def _paint_drives(
    page: Image.Image, layout: Layout, trajectories: Mapping[str, Trajectory]
) -> Iterator[tuple[str, Colour]]:
    """Paint the paths of several drives, the first ones on top; yields the keys to their colours."""
    coloured = list(zip(trajectories.items(), cycle(_DRIVES), strict=False))
    for (_, path), colour in reversed(coloured):
        paint_path(page, layout, path, 3.0, colour, jump_m=_JUMP_M)
        disc(page, layout.pixels(path.poses[:1, :2]), 7.0 * layout.unit, FREE, colour)
        disc(page, layout.pixels(path.poses[-1:, :2]), 7.0 * layout.unit, colour, OCCUPIED)
    for (name, _), colour in coloured[:_MOST_KEYS]:
        yield name if len(name) <= 24 else f"{name[:23]}…", colour
    if len(coloured) > _MOST_KEYS:
        yield f"and {len(coloured) - _MOST_KEYS} more", FAINT


def draw_localization(
    grid: OccupancyGrid,
    trajectory: Trajectory,
    lost: NDArray[np.bool_],
    *,
    title: str = "",
    caption: Sequence[str] = (),
) -> Image.Image:
    """Draw a map with the reported poses: the trajectory by time, dots where the robot was lost.

    Parameters
    ----------
    grid : OccupancyGrid
        The map in which the robot was localized.
    trajectory : Trajectory
        A pose for each scan, frame of the grid; poses off the map are cut off.
    lost : (N,) bool
        Whether the robot was lost at each; where it was found (again) a disc is drawn.
    title : str
        First line of the caption, in larger letters.
    caption : sequence of str
        Further lines.

    Returns
    -------
    PIL.Image.Image
        RGB, its long side about 1400 to 4000 px.
    """
    layout = lay_out(grid, title, caption)
    page = _paint_cells(grid, layout)
    points = layout.pixels(trajectory.poses[:, :2])
    keys: list[tuple[str, Colour]] = [("found", CLOSURE)]
    if lost.any():
        keys.append(("lost", LOST))
        dots(page, np.unique(np.round(points[lost] / _SPOT_PX), axis=0) * _SPOT_PX, LOST, 3.0 * layout.unit)
    paint_path(page, layout, trajectory, 3.0, hidden=lost, jump_m=_JUMP_M)
    disc(page, points[~lost & np.append(True, lost[:-1])], 8.0 * layout.unit, FREE, CLOSURE)
    if not lost[-1]:
        disc(page, points[-1:], 8.0 * layout.unit, TIME_ENDS[1], OCCUPIED)
    ends = label_time(trajectory)
    paint_footer(page, layout, title, caption, keys, ends)
    return page


def draw_landmarks(
    trajectory: Trajectory,
    positions: FloatArray,
    covariances: FloatArray,
    *,
    title: str = "",
    caption: Sequence[str] = (),
    truth: Trajectory | None = None,
    true_positions: FloatArray | None = None,
    stamped: bool = True,
) -> Image.Image:
    """Draw a trajectory and landmarks with their covariance ellipses over the truth, a scale bar and a caption below.

    Parameters
    ----------
    trajectory : Trajectory
        Coloured by time, its start (white) and end (filled) marked.
    positions, covariances : (M, 2) m, (M, 2, 2) m^2 float64
        Of the landmarks; ellipses are those of `SIGMAS` standard deviations.
    title : str
        First line of the caption, in larger letters.
    caption : sequence of str
        Further lines.
    truth : Trajectory, optional
        In the frame of the other.
    true_positions : (L, 2) float64, m, optional
        True landmarks in that frame, drawn as crosses.
    stamped : bool
        Whether stamps are times; else they only count the steps.

    Returns
    -------
    PIL.Image.Image
        RGB.
    """
    outlines = ellipse(positions, covariances)
    true_marks = np.empty((0, 2)) if true_positions is None else true_positions
    shown = [trajectory.poses[:, :2], outlines.reshape(-1, 2), true_marks]
    if truth is not None:
        shown.append(truth.poses[:, :2])
    page, layout = open_page(np.concatenate(shown), title, caption)
    u = layout.unit
    keys: list[tuple[str, Colour]] = [(f"landmarks, {SIGMAS:g} sigma", CLOSURE)]
    if truth is not None or true_positions is not None:
        keys.append(("truth", TRUTH))
    if truth is not None:
        paint_path(page, layout, truth, 2.0, TRUTH)
    arms = 7.0 * u * np.array([[1.0, 1.0, -1.0, -1.0], [1.0, -1.0, -1.0, 1.0]])
    crosses = np.tile(layout.pixels(true_marks), 2)[:, None] + arms
    stroke(page, crosses.reshape(-1, 4), TRUTH, 2.5 * u)
    paint_path(page, layout, trajectory, 2.0)
    corners = layout.pixels(outlines.reshape(-1, 2)).reshape(-1, _CORNERS + 1, 2)
    stroke(page, np.concatenate([corners[:, :-1], corners[:, 1:]], axis=2).reshape(-1, 4), CLOSURE, 1.5 * u)
    dots(page, layout.pixels(positions), CLOSURE, 5.0 * u)
    mark_ends(page, layout.pixels(trajectory.poses[[0, -1], :2]), 8.0 * u)
    paint_footer(page, layout, title, caption, keys, label_time(trajectory, stamped))
    return page


def ellipse(positions: FloatArray, covariances: FloatArray) -> FloatArray:
    """Outlines (M, 49, 2), closed, of the ellipses (p - m)' C^-1 (p - m) = SIGMAS^2."""
    angle = np.linspace(0.0, math.tau, _CORNERS + 1)
    circle = SIGMAS * np.stack([np.cos(angle), np.sin(angle)])
    variances, axes = np.linalg.eigh(covariances)
    root = axes * np.sqrt(np.maximum(variances, 0.0))[:, None, :]
    return np.asarray(positions[:, None] + (root @ circle).swapaxes(1, 2))


def lay_out(grid: GridRows, title: str = "", caption: Sequence[str] = ()) -> Layout:
    """Decide how large the known part of a grid is shown, and where; a grid without a known cell is shown whole."""
    rows, columns = known_part(grid)
    cells = np.array([columns.stop - columns.start, rows.stop - rows.start])
    least, most = _MAP_SIDE_PX
    px = min(math.ceil(least / cells.max()), _CELL_PX, most / cells.max(), math.sqrt(_MAP_AREA_PX / cells.prod()))
    low = np.add(grid.origin, np.multiply([columns.start, rows.start], grid.resolution_m))
    return Layout.of(low, low + cells * grid.resolution_m, float(px / grid.resolution_m), title, caption)


def known_part(grid: GridRows) -> tuple[slice, slice]:
    """Return the rows and columns from the first to the last with a known cell; all of them, where there is none."""
    height, width = grid.shape
    in_row = np.zeros(height, np.bool_)
    in_column = np.zeros(width, np.bool_)
    for top in range(0, height, _ROWS):
        known = grid.rows(top, min(top + _ROWS, height)).known
        in_row[top : top + _ROWS] = known.any(axis=1)
        in_column |= known.any(axis=0)
    return _extent(in_row), _extent(in_column)


def _extent(known: NDArray[np.bool_]) -> slice:
    """From the first to the last that is known; at least one long."""
    found = np.flatnonzero(known)
    return slice(int(found[0]), int(found[-1]) + 1) if len(found) else slice(0, max(1, len(known)))


def _paint_cells(grid: GridRows, layout: Layout) -> Image.Image:
    """Paint FREE and then OCCUPIED over a page, by how much a pixel is so."""
    levels = _levels(grid)
    page = Image.new("RGB", layout.size, UNKNOWN)
    left, top, right, bottom = layout.map_box
    is_larger = right - left > levels.width
    resample = Image.Resampling.BICUBIC if is_larger else Image.Resampling.BOX
    for table, colour in ((_FREE_LEVELS, FREE), (_OCCUPIED_LEVELS, OCCUPIED)):
        share = levels.point(table).resize((right - left, bottom - top), resample)
        page.paste(colour, layout.map_box, share.point(_CRISP) if is_larger else share)
    return page


def _levels(grid: GridRows) -> Image.Image:
    """Log-odds of the known part as an image of bytes, the uppermost row first."""
    rows, columns = known_part(grid)
    levels = np.full((rows.stop - rows.start, columns.stop - columns.start), _EVEN, np.uint8)
    for first in range(rows.start, min(rows.stop, grid.shape[0]), _ROWS):
        last = min(first + _ROWS, rows.stop, grid.shape[0])
        band = grid.rows(first, last)
        scaled = np.clip(band.log_odds[:, columns] * _LEVELS_PER_NAT + _EVEN, 0, 255)
        shown = levels[first - rows.start : last - rows.start, : scaled.shape[1]]
        np.copyto(shown, scaled, where=band.known[:, columns], casting="unsafe")
    return Image.fromarray(levels[::-1])
