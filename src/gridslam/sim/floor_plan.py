"""Floor plans: walls are line segments (S, 4) = [x0, y0, x1, y1] in m, made by a few builders and joined by `join`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from gridslam.errors import ArgumentError
from gridslam.geometry import se2
from gridslam.types import FloatArray

WALL_THICKNESS_M = 0.12
"""An inner wall: thick enough that its two faces are two lines of 5 cm cells in a map, as in a real building."""


def join(*parts: FloatArray) -> FloatArray:
    """Join walls (S, 4) of several parts into one floor plan."""
    return np.concatenate([np.empty((0, 4)), *parts])


def polyline(points: ArrayLike, *, closed: bool = False) -> FloatArray:
    """Thin walls (N - 1, 4) through points (N, 2) in m; `closed` adds the one from the last point to the first."""
    nodes = np.asarray(points, dtype=np.float64)
    if closed:
        nodes = np.concatenate([nodes, nodes[:1]])
    return np.concatenate([nodes[:-1], nodes[1:]], axis=1)


def box(x0: float, y0: float, x1: float, y1: float) -> FloatArray:
    """Outline (4, 4) of an upright rectangle with opposite corners (x0, y0) and (x1, y1) in m."""
    return polyline([(x0, y0), (x1, y0), (x1, y1), (x0, y1)], closed=True)


def wall(
    start: tuple[float, float],
    end: tuple[float, float],
    doors: Sequence[tuple[float, float]] = (),
    thickness_m: float = WALL_THICKNESS_M,
) -> FloatArray:
    """Build a straight wall with door openings.

    Parameters
    ----------
    start, end : (float, float), m
        Ends of its centre line.
    doors : sequence of (float, float), m
        For each opening the distance of its middle from `start`, and its width; in ascending order.
    thickness_m : float, m, > 0

    Returns
    -------
    (4 K, 4) float64, m
        The outlines of the K pieces between the openings.

    Raises
    ------
    ArgumentError
        If openings overlap, are out of order or reach beyond the wall.
    """
    length = math.hypot(end[0] - start[0], end[1] - start[1])
    edges = [0.0, *(edge for middle, width in doors for edge in (middle - width / 2, middle + width / 2)), length]
    if any(left > right for left, right in pairwise(edges)):
        raise ArgumentError("doors", f"openings in order within the wall's {length:g} m", list(doors))
    half = thickness_m / 2
    pieces = [box(a, -half, b, half) for a, b in zip(edges[::2], edges[1::2], strict=True) if b > a]
    return place(join(*pieces), (start[0], start[1], math.atan2(end[1] - start[1], end[0] - start[0])))


def room(
    x0: float,
    y0: float,
    x1: float,
    y1: float,
    *,
    south: Sequence[tuple[float, float]] = (),
    north: Sequence[tuple[float, float]] = (),
    west: Sequence[tuple[float, float]] = (),
    east: Sequence[tuple[float, float]] = (),
) -> FloatArray:
    """Return four walls around an upright rectangle (centre lines, m).

    Parameters
    ----------
    x0, y0, x1, y1 : float, m
        Lower left and upper right corner.
    south, north, west, east : sequence of (float, float), m
        Openings of each side as in `wall`, from x0 or from y0 on.
    """
    ends = ((x0, y0, x1, y0, south), (x0, y1, x1, y1, north), (x0, y0, x0, y1, west), (x1, y0, x1, y1, east))
    return join(*(wall((a, b), (c, d), doors) for a, b, c, d, doors in ends))


def pillar(x: float, y: float, radius_m: float, sides: int = 16) -> FloatArray:
    """Regular polygon (sides, 4) with its corners on a circle: a round pillar, or with few sides a crate."""
    angles = 2 * math.pi * np.arange(sides) / sides
    return polyline(np.array([x, y]) + radius_m * np.stack([np.cos(angles), np.sin(angles)], axis=1), closed=True)


def furniture(x: float, y: float, width_m: float, depth_m: float, heading_rad: float = 0.0) -> FloatArray:
    """Outline (4, 4) of a table, shelf or cabinet: a rectangle about (x, y), `width_m` along its heading."""
    return place(box(-width_m / 2, -depth_m / 2, width_m / 2, depth_m / 2), (x, y, heading_rad))


def place(walls: FloatArray, pose: ArrayLike) -> FloatArray:
    """Carry walls (S, 4) from the frame of `pose` (3,) [m, m, rad] to the frame in which `pose` is given."""
    return se2.transform_points(pose, walls.reshape(-1, 2)).reshape(-1, 4)


def clearance(walls: FloatArray, points: FloatArray) -> FloatArray:
    """Return distance in m (N,) from points (N, 2) to the nearest of walls (S, 4); infinite where there are none."""
    distances = np.full(len(points), np.inf)
    for x0, y0, x1, y1 in walls.tolist():
        dx = x1 - x0
        dy = y1 - y0
        px = points[:, 0] - x0
        py = points[:, 1] - y0
        along = np.clip((px * dx + py * dy) / max(dx * dx + dy * dy, 1e-300), 0.0, 1.0)
        np.minimum(distances, np.hypot(px - along * dx, py - along * dy), out=distances)
    return distances


def near(walls: FloatArray, points: FloatArray, reach_m: float) -> FloatArray:
    """Return those of walls (S, 4), in their order, that may be within `reach_m` of one of points (N, 2).

    Uses upright boxes around each wall and around all points: no near wall is left out, some far ones are kept.
    """
    low = points.min(axis=0) - reach_m
    high = points.max(axis=0) + reach_m
    ends = walls.reshape(-1, 2, 2)
    return np.asarray(walls[((ends.max(axis=1) >= low) & (ends.min(axis=1) <= high)).all(axis=1)])
