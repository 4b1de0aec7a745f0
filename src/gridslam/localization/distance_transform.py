"""Euclidean distance to the nearest occupied cell, of a whole map at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["distance_transform"]


def distance_transform(occupied: NDArray[np.bool_], reach: int) -> NDArray[np.float32]:
    """Distance (H, W) float32 in cells from each cell's centre to that of the nearest occupied one, at most `reach`.

    Exact up to there: first along columns, then the least of a row's sums of squares.

    Parameters
    ----------
    occupied : (H, W) bool
    reach : int, cells, >= 1

    Source: Felzenszwalb and Huttenlocher, Distance transforms of sampled functions (2012), with the lower envelope of
    parabolas found by trying the 2 reach + 1 that can matter.
    """
    height, width = occupied.shape
    rows = np.arange(height, dtype=np.float32)[:, None]
    above = np.maximum.accumulate(np.where(occupied, rows, -np.inf), axis=0)
    below = np.minimum.accumulate(np.where(occupied, rows, np.inf)[::-1], axis=0)[::-1]
    column = np.minimum(np.minimum(rows - above, below - rows), reach).astype(np.float32) ** 2
    squares = column.copy()
    for step in range(1, min(reach, width - 1) + 1):
        aside = np.float32(step * step)
        np.minimum(squares[:, step:], column[:, :-step] + aside, out=squares[:, step:])
        np.minimum(squares[:, :-step], column[:, step:] + aside, out=squares[:, :-step])
    return np.sqrt(np.minimum(squares, np.float32(reach * reach)))
