"""How far an increment of odometry goes, and how uncertain it is to the tracker."""

from __future__ import annotations

import math

from gridslam.types import FloatArray

__all__ = ["motion_of", "odometry_sigmas"]


def motion_of(increment: FloatArray) -> tuple[float, float]:
    """Metres and radians of an increment (3,)."""
    x, y, turn = increment.tolist()
    return math.hypot(x, y), abs(turn)


def odometry_sigmas(moved_m: float, turned_rad: float, cell_m: float) -> tuple[float, float]:
    """Standard deviations (m, rad) of an increment of odometry, from a tenth of a cell on."""
    sigma_m = 0.1 * cell_m + 0.15 * moved_m + 0.5 * cell_m * turned_rad
    return sigma_m, 0.003 + 0.05 * turned_rad + 0.04 * moved_m
