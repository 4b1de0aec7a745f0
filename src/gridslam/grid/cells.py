"""Cells of a map: their indices in the world, and the log-odds that a beam adds to them.

Cell (row, column) = (0, 0) has its lower left corner at the world's origin; indices are signed, so a map grows in every
direction. This is the only place in Python where world coordinates become indices.
"""

from __future__ import annotations

import math
from typing import final

import numpy as np
from numpy.typing import NDArray

from gridslam.checked import checked
from gridslam.errors import ArgumentError
from gridslam.kernels import UNKNOWN
from gridslam.kernels.reference_update import cells_within
from gridslam.types import FloatArray, IntArray


@checked
def cells_of(points: FloatArray, resolution_m: float) -> IntArray:
    """Signed cell indices (..., 2) = [row, column] that hold points (..., 2) = [x m, y m].

    They are at most 2^30, beyond which nothing is mapped; what is not finite lies there, too.
    """
    return cells_within(np.floor(points[..., ::-1] * (1.0 / resolution_m))).astype(np.int64)


@checked
def cell_centres(cells: NDArray[np.integer], resolution_m: float) -> FloatArray:
    """World coordinates (..., 2) = [x m, y m] of the centres of cells (..., 2) = [row, column]."""
    return (np.asarray(cells, dtype=np.float64)[..., ::-1] + 0.5) * resolution_m


def cell_corner(row: int, column: int, resolution_m: float) -> tuple[float, float]:
    """World coordinates (x m, y m) of the lower left corner of a cell."""
    return column * resolution_m, row * resolution_m


LOG_ODDS_UNIT = 0.01
"""Nats in one step of evidence."""

_BYTE = 127


@final
@checked
class Evidence:
    """The evidence of a beam for a cell in log-odds, and the clamps, rounded to steps of `LOG_ODDS_UNIT`.

    Parameters
    ----------
    hit, miss, minimum, maximum, occupied_above : float, nats
        `occupied_above` is the log-odds above which a cell counts as occupied for the distance field.

    Attributes
    ----------
    steps : tuple of five int
        The parameters, in units of `LOG_ODDS_UNIT`.
    occupied_above : int
        The last of them.
    byte_unit : int or None
        The greatest unit, in steps, of which all five are whole multiples: what a cell holds is one, too. None where a
        byte cannot hold it.
    """

    __slots__ = ("byte_unit", "occupied_above", "steps")

    def __init__(self, hit: float, miss: float, minimum: float, maximum: float, occupied_above: float) -> None:
        steps = tuple(round(v / LOG_ODDS_UNIT) for v in (hit, miss, minimum, maximum, occupied_above))
        widest = steps[3] - steps[2] - steps[1]  # what the kernels subtract in 16 bits
        if not (steps[1] < 0 < steps[0] < -UNKNOWN and steps[2] < 0 < steps[3] and widest < -UNKNOWN):
            got = hit, miss, minimum, maximum
            expected = "miss < 0 < hit < 327 nats and clamps that are, with a miss, less than 327 nats apart"
            raise ArgumentError("Evidence", expected, got)
        self.steps: tuple[int, ...] = steps
        self.occupied_above: int = steps[4]
        unit = math.gcd(*steps)
        fits = max(map(abs, steps)) <= _BYTE * unit and widest <= (2 * _BYTE + 1) * unit
        self.byte_unit: int | None = unit if fits else None
