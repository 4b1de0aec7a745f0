"""NumPy twin of the kernel that weighs many poses in one plain array; see `gridslam.kernels.reference`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam.kernels.reference_update import FloatArray, placed

__all__ = ["sum_at_ends"]

_AT_ONCE = 1 << 20  # look-ups: some 50 MB of intermediate arrays


def sum_at_ends(
    field: NDArray[np.float32], corner: FloatArray, resolution: float, poses: FloatArray, ends: FloatArray, threads: int
) -> FloatArray:
    """Sum over beams of a field (H, W) at their ends (B, 2), seen from poses (K, 3): (K,) float64.

    The field is known at the centres of cells, the first of which has its lower left corner at `corner` (2,), and
    bilinear between them. What lies beyond takes the value of the nearest cell at the border, so the caller puts there
    what is to hold outside. H and W are at least 2.
    """
    some = max(_AT_ONCE // max(len(ends), 1), 1)
    parts = [_sums(field, corner, resolution, poses[k : k + some], ends) for k in range(0, len(poses), some)]
    return np.concatenate(parts) if parts else np.zeros(0)


def _sums(
    field: NDArray[np.float32], corner: FloatArray, resolution: float, poses: FloatArray, ends: FloatArray
) -> FloatArray:
    rows, columns = field.shape
    x, y = placed(poses, ends)
    u = np.clip((x - corner[0]) / resolution - 0.5, 0, np.nextafter(columns - 1, 0))
    v = np.clip((y - corner[1]) / resolution - 0.5, 0, np.nextafter(rows - 1, 0))
    column, row = u.astype(np.int64), v.astype(np.int64)
    a, b, at = u - column, v - row, row * columns + column
    f00, f01, f10, f11 = (field.reshape(-1)[at + step] for step in (0, 1, columns, columns + 1))
    low, high = f00 + a * (f01 - f00), f10 + a * (f11 - f10)
    sums: FloatArray = (low + b * (high - low)).sum(axis=1, dtype=np.float64)
    return sums
