"""World coordinates and cell indices: the only place in Python where one becomes the other.

Cell (row, column) = (0, 0) has its lower left corner at the world's origin; indices are signed, so a map grows in every
direction.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam.types import FloatArray, IntArray

__all__ = ["cell_centres", "cell_corner", "cells_of"]


def cells_of(points: FloatArray, resolution_m: float) -> IntArray:
    """Signed cell indices (..., 2) = [row, column] that hold points (..., 2) = [x m, y m]."""
    return np.floor(points[..., ::-1] * (1.0 / resolution_m)).astype(np.int64)


def cell_centres(cells: NDArray[np.integer], resolution_m: float) -> FloatArray:
    """World coordinates (..., 2) = [x m, y m] of the centres of cells (..., 2) = [row, column]."""
    return (np.asarray(cells, dtype=np.float64)[..., ::-1] + 0.5) * resolution_m


def cell_corner(row: int, column: int, resolution_m: float) -> tuple[float, float]:
    """World coordinates (x m, y m) of the lower left corner of a cell."""
    return column * resolution_m, row * resolution_m
