"""Maps whose rows are not parallel to the axes of their frame, sampled along these."""

from __future__ import annotations

import math
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

__all__ = ["turn_cells"]

_QUARTER_RAD = 1e-3  # from a quarter turn: half a cell of 5 cm in 25 m
_BAND = 256  # rows at a time

_Value = TypeVar("_Value", bound=np.generic)


def turn_cells(
    cells: NDArray[_Value], resolution_m: float, corner: tuple[float, float], yaw_rad: float, unknown: int
) -> tuple[NDArray[_Value], tuple[float, float]]:
    """Sample a map that is turned about its lower left corner along the axes of its frame.

    Quarter turns give each cell another place. Otherwise a cell takes the value of the one in which its centre lies, so
    that nothing moves by more than 0.71 cells.

    Parameters
    ----------
    cells : (H, W)
        The first row is the lowest one before the turn.
    resolution_m : float, m
        Side of a cell.
    corner : (float, float), m
        Lower left corner of the map, about which it is turned.
    yaw_rad : float, rad
        The turn, to the left.
    unknown : int
        Value of the cells outside.

    Returns
    -------
    cells : (H', W')
        As small as they hold the whole map.
    corner : (float, float), m
        Their lower left corner.
    """
    height, width = cells.shape
    quarters = round(yaw_rad / (math.pi / 2))
    is_quarter = abs(yaw_rad - quarters * math.pi / 2) < _QUARTER_RAD
    yaw_rad = quarters * math.pi / 2 if is_quarter else yaw_rad
    cosine, sine = math.cos(yaw_rad), math.sin(yaw_rad)
    corners = np.array([[0, 0], [width, 0], [0, height], [width, height]]) @ np.array([[cosine, sine], [-sine, cosine]])
    low = corners.min(axis=0)
    x, y = (np.array(corner) + resolution_m * low).tolist()
    if is_quarter:
        return np.rot90(cells, -quarters), (x, y)
    columns, rows = np.ceil(corners.max(axis=0) - low).astype(int).tolist()
    turned = np.full((rows, columns), unknown, cells.dtype)
    across = low[0] + 0.5 + np.arange(columns)
    for first in range(0, rows, _BAND):
        up = (low[1] + 0.5 + np.arange(first, min(first + _BAND, rows)))[:, None]
        column = np.floor(cosine * across + sine * up).astype(np.int64)
        row = np.floor(cosine * up - sine * across).astype(np.int64)
        is_inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        turned[first : first + _BAND][is_inside] = cells[row[is_inside], column[is_inside]]
    return turned, (x, y)
