"""Picture of landmarks: trajectory of the robot, landmarks with their covariance ellipses, and the truth."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from PIL import Image

from gridslam.types import FloatArray, Trajectory
from gridslam.viz.footer import Key, paint_footer
from gridslam.viz.layout import MARGIN, Layout, footer_size
from gridslam.viz.palette import CLOSURE, FREE, OCCUPIED, TIME_ENDS, TRUTH, UNKNOWN, time_colours
from gridslam.viz.strokes import disc, stroke

__all__ = ["draw_landmarks", "ellipse"]

_SIDE_PX, _WIDTH_PX = 1600, 1400  # the long side of what is drawn; the page is at least as wide as the second
_UNIT = 1.2
_NODE_PX = 3.0  # a path is thinned to nodes this far apart
_CORNERS = 48
SIGMAS = 3.0
"""Ellipses are drawn at this many standard deviations: they contain the landmark with 98.9 %."""


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
    shown = [trajectory.poses[:, :2], outlines.reshape(-1, 2)]
    shown += [] if truth is None else [truth.poses[:, :2]]
    shown += [] if true_positions is None else [true_positions]
    layout = _laid_out(np.concatenate(shown), title, caption)
    page = Image.new("RGB", layout.size, UNKNOWN)
    page.paste(FREE, layout.map_box)
    keys: list[Key] = [(f"landmarks, {SIGMAS:g} sigma", CLOSURE)]
    if truth is not None:
        segments, _ = _path(truth, layout)
        stroke(page, segments, [TRUTH] * len(segments), 2.0 * _UNIT)
    if true_positions is not None:
        _cross(page, layout.pixels(true_positions))
    if truth is not None or true_positions is not None:
        keys.append(("truth", TRUTH))
    segments, shares = _path(trajectory, layout)
    stroke(page, segments, time_colours(shares), 2.0 * _UNIT)
    corners = layout.pixels(outlines.reshape(-1, 2)).reshape(-1, _CORNERS + 1, 2)
    lines = np.concatenate([corners[:, :-1], corners[:, 1:]], axis=2).reshape(-1, 4)
    stroke(page, lines, [CLOSURE] * len(lines), 1.5 * _UNIT)
    dots = np.tile(layout.pixels(positions), 2)
    stroke(page, dots, [CLOSURE] * len(dots), 5.0 * _UNIT)
    (start, end), (first, last) = layout.pixels(trajectory.poses[[0, -1], :2]).tolist(), TIME_ENDS
    disc(page, start, 8.0 * _UNIT, FREE, first)
    disc(page, end, 8.0 * _UNIT, last, OCCUPIED)
    paint_footer(page, layout, title, caption, trajectory, keys, stamped)
    return page


def ellipse(positions: FloatArray, covariances: FloatArray) -> FloatArray:
    """Outlines (M, 49, 2), closed, of the ellipses (p - m)' C^-1 (p - m) = SIGMAS^2."""
    angle = np.linspace(0.0, math.tau, _CORNERS + 1)
    circle = SIGMAS * np.stack([np.cos(angle), np.sin(angle)])
    variances, axes = np.linalg.eigh(covariances)
    root = axes * np.sqrt(np.maximum(variances, 0.0))[:, None, :]
    return np.asarray(positions[:, None] + (root @ circle).swapaxes(1, 2))


def _laid_out(points: FloatArray, title: str, caption: Sequence[str]) -> Layout:
    """Page for points (N, 2) with a border of a twentieth."""
    low, high = points.min(axis=0), points.max(axis=0)
    span = np.maximum(high - low, 1e-3)
    border = 0.05 * span.max()
    span = span + 2 * border
    px_per_m = float(_SIDE_PX / span.max())
    width, height = (math.ceil(side * px_per_m) for side in span.tolist())
    margin, footer = round(MARGIN * _UNIT), footer_size(title, caption, _UNIT)
    page = max(width + 2 * margin, footer[0] + _WIDTH_PX // 2 + 3 * margin, _WIDTH_PX)
    left = (page - width) // 2
    size = page, height + 3 * margin + footer[1]
    box = left, margin, left + width, margin + height
    none = slice(0, 0)
    return Layout(none, none, size, box, px_per_m, float(low[0] - border), float(high[1] + border), _UNIT)


def _path(trajectory: Trajectory, layout: Layout) -> tuple[FloatArray, FloatArray]:
    """Segments (K, 4) of a path in px, thinned, and when each ends, as a share (K,) of the whole time."""
    points = layout.pixels(trajectory.poses[:, :2])
    walked = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))]) // _NODE_PX
    kept = np.union1d(np.flatnonzero(np.diff(walked, prepend=-1.0)), len(points) - 1)
    passed = (trajectory.stamps_ns - trajectory.stamps_ns[0])[kept[1:]] / max(int(np.ptp(trajectory.stamps_ns)), 1)
    return np.concatenate([points[kept[:-1]], points[kept[1:]]], axis=1), passed


def _cross(page: Image.Image, points: FloatArray) -> None:
    arm = 7.0 * _UNIT
    for offset in np.array([[arm, arm], [arm, -arm]]):
        ends = np.concatenate([points - offset, points + offset], axis=1)
        stroke(page, ends, [TRUTH] * len(ends), 2.5 * _UNIT)
