"""NumPy twin of the kernel that weighs many poses in one plain array; see `gridslam.kernels.reference`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam.kernels.reference_update import FloatArray, transform_to_world

__all__ = ["sum_at_ends"]

_AT_ONCE = 1 << 20  # look-ups: some 50 MB of intermediate arrays


def sum_at_ends(
    patches: NDArray[np.uint32], corner: FloatArray, resolution: float, poses: FloatArray, ends: FloatArray,
    threads: int,
) -> FloatArray:  # fmt: skip
    """Sum over beams of a field at their ends (B, 2), seen from poses (K, 3): (K,) float64.

    The field, 0 to 255, is known at the centres of cells, the first of which has its lower left corner at `corner`
    (2,), and bilinear between them. A patch (H, W) holds four of its values in a word: the cell's own, those of the
    cells to its right, above, and above to the right, from the least significant byte on. What lies beyond takes the
    value of the nearest cell at the border, so the caller puts there what is to hold outside.
    """
    some = max(_AT_ONCE // max(len(ends), 1), 1)
    parts = [_sums(patches, corner, resolution, poses[k : k + some], ends) for k in range(0, len(poses), some)]
    return np.concatenate(parts) if parts else np.zeros(0)


def _sums(
    patches: NDArray[np.uint32], corner: FloatArray, resolution: float, poses: FloatArray, ends: FloatArray
) -> FloatArray:
    rows, columns = patches.shape
    x, y = transform_to_world(poses, ends)
    u = np.clip((x - corner[0]) / resolution - 0.5, 0, np.nextafter(columns, 0))
    v = np.clip((y - corner[1]) / resolution - 0.5, 0, np.nextafter(rows, 0))
    column, row = u.astype(np.int64), v.astype(np.int64)
    a, b, patch = u - column, v - row, patches[row, column]
    f00, f01, f10, f11 = ((patch >> shift & 255).astype(np.float64) for shift in (0, 8, 16, 24))
    low, high = f00 + a * (f01 - f00), f10 + a * (f11 - f10)
    sums: FloatArray = (low + b * (high - low)).sum(axis=1)
    return sums
