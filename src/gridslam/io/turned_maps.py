"""Maps whose rows are not parallel to the axes of their frame, sampled along these."""

from __future__ import annotations

import math
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

_QUARTER_RAD = 1e-3  # from a quarter turn: half a cell of 5 cm in 25 m

_Value = TypeVar("_Value", bound=np.generic)


def count_turned_cells(shape: tuple[int, int], yaw_rad: float) -> int:
    """Number of cells that `turn_cells` returns for a shape (H, W)."""
    rows, columns = _find_bounds(shape, _find_turn(yaw_rad))[1]
    return rows * columns


def _find_turn(yaw_rad: float) -> NDArray[np.float64]:
    """Rotation (2, 2) by a yaw, or by the quarter turns that it nearly is."""
    quarters = round(yaw_rad / (math.pi / 2)) * math.pi / 2
    yaw_rad = quarters if abs(yaw_rad - quarters) < _QUARTER_RAD else yaw_rad
    cosine, sine = math.cos(yaw_rad), math.sin(yaw_rad)
    return np.array([[cosine, -sine], [sine, cosine]]).round(15)


def _find_bounds(shape: tuple[int, int], turn: NDArray[np.float64]) -> tuple[NDArray[np.float64], tuple[int, int]]:
    """Lowest x and y (2,) of a turned map, in cells from its corner, and how many rows and columns hold it."""
    height, width = shape
    corners = np.array([[0, 0], [width, 0], [0, height], [width, height]]) @ turn.T
    low = corners.min(axis=0)
    columns, rows = np.ceil(corners.max(axis=0) - low).astype(int).tolist()
    return low, (rows, columns)


def turn_cells(
    cells: NDArray[_Value], resolution_m: float, corner: tuple[float, float], yaw_rad: float, unknown: int
) -> tuple[NDArray[_Value], tuple[float, float]]:
    """Sample a map that is turned about its lower left corner along the axes of its frame.

    A cell takes the value of the one in which its centre lies, so that nothing moves by more than 0.71 cells; quarter
    turns give each cell another place.

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
    from scipy import ndimage  # few maps are turned

    turn = _find_turn(yaw_rad)
    low, shape = _find_bounds((cells.shape[0], cells.shape[1]), turn)
    x, y = (np.array(corner) + resolution_m * low).tolist()
    offset = turn @ (low[::-1] + 0.5) - 0.5  # of rows and columns, which are y and x: the inverse turn
    turned = ndimage.affine_transform(cells, turn, offset, shape, order=0, mode="grid-constant", cval=unknown)
    return turned, (x, y)
