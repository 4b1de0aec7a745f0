"""Picture of a localization: the map, the trajectory in it, and where the robot was lost and localized."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from gridslam.types import FloatArray, OccupancyGrid, Trajectory
from gridslam.viz.footer import Key, paint_footer
from gridslam.viz.layout import Layout, lay_out
from gridslam.viz.palette import CLOSURE, FREE, OCCUPIED, TIME_ENDS, Colour, time_colours
from gridslam.viz.picture import draw_map
from gridslam.viz.strokes import disc, stroke

__all__ = ["LOST", "draw_localization"]

LOST: Colour = (214, 40, 40)

_NODE_PX = 3.0  # the way is thinned to nodes this far apart
_JUMP_M = 1.0  # a longer step is no way that was driven


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
    page, layout = draw_map(grid, title=title, caption=caption), lay_out(grid, title, caption)
    points = layout.pixels(trajectory.poses[:, :2])
    _paint_lost(page, points[lost], layout)
    _paint_way(page, points, trajectory, lost, layout)
    found = np.flatnonzero(~lost & np.append(True, lost[:-1]))
    for place in points[found].tolist():
        disc(page, (place[0], place[1]), 8.0 * layout.unit, FREE, CLOSURE)
    if not lost[-1]:
        last = points[-1].tolist()
        disc(page, (last[0], last[1]), 8.0 * layout.unit, TIME_ENDS[1], OCCUPIED)
    keys: list[Key] = [("found", CLOSURE), *([("lost", LOST)] if lost.any() else [])]
    paint_footer(page, layout, title, caption, trajectory, keys)
    return page


def _paint_lost(page: Image.Image, points: FloatArray, layout: Layout) -> None:
    """Dots at the reported poses while the robot was lost, those on one spot once."""
    if len(points):
        spots = np.unique(np.round(points / _NODE_PX), axis=0) * _NODE_PX
        stroke(page, np.tile(spots, 2), [LOST] * len(spots), 3.0 * layout.unit)


def _paint_way(
    page: Image.Image, points: FloatArray, trajectory: Trajectory, lost: NDArray[np.bool_], layout: Layout
) -> None:
    """Segments between poses at which the robot was not lost, coloured by time."""
    walked = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))]) // _NODE_PX
    changes = np.flatnonzero(np.diff(lost))
    kept = np.unique(np.concatenate([np.flatnonzero(np.diff(walked, prepend=-1.0)), changes, changes + 1]))
    first, second = kept[:-1], kept[1:]
    steps = np.hypot(*(points[second] - points[first]).T)
    drawn = ~lost[first] & ~lost[second] & (steps < _JUMP_M * layout.px_per_m)
    passed = np.maximum.accumulate(trajectory.stamps_ns - trajectory.stamps_ns[0]).astype(np.float64)
    shares = passed[second[drawn]] / max(passed[-1], 1.0)
    segments = np.concatenate([points[first[drawn]], points[second[drawn]]], axis=1)
    stroke(page, segments, time_colours(shares), 3.0 * layout.unit)
