"""Maps whose rows are not parallel to the axes of their frame, sampled along these."""

from __future__ import annotations

import math
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

_QUARTER_RAD = 1e-3  # from a quarter turn: half a cell of 5 cm in 25 m
_BAND = 256  # rows at a time

_Value = TypeVar("_Value", bound=np.generic)


def count_turned_cells(shape: tuple[int, int], yaw_rad: float) -> int:
    """Number of cells that `turn_cells` returns for a shape (H, W)."""
    rows, columns = shape if _find_quarters(yaw_rad) is not None else _find_bounds(shape, yaw_rad)[1]
    return rows * columns


def _find_quarters(yaw_rad: float) -> int | None:
    """The number of quarter turns that a yaw is; None for another."""
    quarters = round(yaw_rad / (math.pi / 2))
    return quarters if abs(yaw_rad - quarters * math.pi / 2) < _QUARTER_RAD else None


def _find_bounds(shape: tuple[int, int], yaw_rad: float) -> tuple[NDArray[np.float64], tuple[int, int]]:
    """Lowest x and y (2,) of a turned map, in cells from its corner, and how many rows and columns hold it."""
    height, width = shape
    cosine, sine = math.cos(yaw_rad), math.sin(yaw_rad)
    corners = np.array([[0, 0], [width, 0], [0, height], [width, height]]) @ np.array([[cosine, sine], [-sine, cosine]])
    low = corners.min(axis=0)
    columns, rows = np.ceil(corners.max(axis=0) - low).astype(int).tolist()
    return low, (rows, columns)


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
    quarters = _find_quarters(yaw_rad)
    yaw_rad = yaw_rad if quarters is None else quarters * math.pi / 2
    low, (rows, columns) = _find_bounds((height, width), yaw_rad)
    x, y = (np.array(corner) + resolution_m * low).tolist()
    if quarters is not None:
        return np.rot90(cells, -quarters), (x, y)
    cosine, sine = math.cos(yaw_rad), math.sin(yaw_rad)
    turned = np.full((rows, columns), unknown, cells.dtype)
    across = low[0] + 0.5 + np.arange(columns)
    for first in range(0, rows, _BAND):
        up = (low[1] + 0.5 + np.arange(first, min(first + _BAND, rows)))[:, None]
        column = np.floor(cosine * across + sine * up).astype(np.int64)
        row = np.floor(cosine * up - sine * across).astype(np.int64)
        is_inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        turned[first : first + _BAND][is_inside] = cells[row[is_inside], column[is_inside]]
    return turned, (x, y)
