"""Buildings of any size, of which a robot sees the same at a time."""

from __future__ import annotations

import math

import numpy as np

from gridslam.sim import World
from gridslam.sim.floor_plan import box, join, place
from gridslam.types import FloatArray

_CORRIDOR_M = 2.4


def ring(side_m: float, rng: np.random.Generator) -> World:
    """A corridor around a square building, cabinets on both sides; the route goes along three of its four sides.

    What the robot sees at a time is alike at every size, and it never comes back to where it was.
    """
    inner = side_m - _CORRIDOR_M
    sides = [(0, 0, 0), (side_m, 0, math.pi / 2), (side_m, side_m, math.pi), (0, side_m, -math.pi / 2)]
    cabinets = [place(_cabinets(side_m, rng), side) for side in sides]
    walls = join(box(0, 0, side_m, side_m), box(_CORRIDOR_M, _CORRIDOR_M, inner, inner), *cabinets)
    near, far = _CORRIDOR_M / 2, side_m - _CORRIDOR_M / 2
    return World.of(f"ring{side_m:g}", walls, [(4.0, near), (far, near), (far, far), (4.0, far)])


def _cabinets(length_m: float, rng: np.random.Generator) -> FloatArray:
    """Boxes along a corridor on the x axis, clear of its corners, now on one wall and now on the other."""
    boxes, x = [], 1.5 * _CORRIDOR_M
    while (x := x + rng.uniform(1.0, 5.0)) < length_m - 2 * _CORRIDOR_M:
        width, depth = rng.uniform(0.5, 1.8), rng.uniform(0.25, 0.5)
        y = 0.0 if rng.random() < 0.5 else _CORRIDOR_M - depth
        boxes.append(box(x, y, x + width, y + depth))
        x += width
    return join(*boxes)
