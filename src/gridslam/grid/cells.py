"""Cells of a map: their indices in the world, and the log-odds that a beam adds to them.

Cell (row, column) = (0, 0) has its lower left corner at the world's origin; indices are signed, so a map grows in every
direction. This is the only place in Python where world coordinates become indices.
"""

from __future__ import annotations

from typing import final

import numpy as np
from numpy.typing import NDArray

from gridslam.errors import ArgumentError
from gridslam.kernels import UNKNOWN
from gridslam.types import FloatArray, IntArray

__all__ = ["LOG_ODDS_UNIT", "Evidence", "cell_centres", "cell_corner", "cells_of"]


def cells_of(points: FloatArray, resolution_m: float) -> IntArray:
    """Signed cell indices (..., 2) = [row, column] that hold points (..., 2) = [x m, y m]."""
    return np.floor(points[..., ::-1] * (1.0 / resolution_m)).astype(np.int64)


def cell_centres(cells: NDArray[np.integer], resolution_m: float) -> FloatArray:
    """World coordinates (..., 2) = [x m, y m] of the centres of cells (..., 2) = [row, column]."""
    return (np.asarray(cells, dtype=np.float64)[..., ::-1] + 0.5) * resolution_m


def cell_corner(row: int, column: int, resolution_m: float) -> tuple[float, float]:
    """World coordinates (x m, y m) of the lower left corner of a cell."""
    return column * resolution_m, row * resolution_m


LOG_ODDS_UNIT = 0.01
"""Nats in one step of a stored log-odds."""


@final
class Evidence:
    """What a beam adds to a cell's log-odds, and the clamps, rounded to steps of `LOG_ODDS_UNIT`.

    Parameters
    ----------
    hit, miss, minimum, maximum, occupied_above : float, nats
        `occupied_above` is the log-odds above which a cell counts as occupied for the distance field.
    """

    __slots__ = ("occupied_above", "steps")

    def __init__(self, hit: float, miss: float, minimum: float, maximum: float, occupied_above: float) -> None:
        steps = tuple(round(v / LOG_ODDS_UNIT) for v in (hit, miss, minimum, maximum, occupied_above))
        if not (steps[1] < 0 < steps[0] and UNKNOWN < steps[2] < 0 < steps[3] and steps[3] - steps[2] < -UNKNOWN):
            got = hit, miss, minimum, maximum
            raise ArgumentError("Evidence", "miss < 0 < hit and clamps less than 327 nats apart", got)
        self.steps: tuple[int, ...] = steps
        self.occupied_above: int = steps[4]
