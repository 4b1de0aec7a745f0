"""NumPy twins of the kernels that search a whole window of a map; here the search is exhaustive."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gridslam.kernels.reference_update import FloatArray, Int32Array, IntArray

__all__ = ["correlate", "max_pyramid"]

Bytes = NDArray[np.uint8]

_STRIP = 64  # zeros before each row of the top level


def max_pyramid(likelihood: Bytes, levels: int) -> tuple[Bytes, Bytes]:
    """For each level h the greatest value of the square of 2^h cells that begins at each cell of `likelihood` (H, W).

    Returns
    -------
    fine : (levels, H + 2 s, W + 2 s) uint8
        Levels 0 to `levels` - 1 in a frame of s = 2^levels cells; outside the map all is 0.
    top : (s, s, Q + 1, 64 + P) uint8
        Level `levels`, every s-th cell together: [y mod s, x mod s, y / s, 64 + x / s] of the framed cell (y, x). The
        last row and the first 64 columns are 0.

    Source: Hess et al., Real-time loop closure in 2D lidar SLAM (ICRA 2016), precomputed grids.
    """
    side = 2**levels
    fine = [np.pad(likelihood, side)]
    for h in range(levels):
        below, step = np.pad(fine[h], (0, 2**h)), 2**h
        halves = np.maximum(below[:, :-step], below[:, step:])
        fine.append(np.maximum(halves[:-step], halves[step:]))
    rows, cols = fine[0].shape
    whole = np.pad(fine.pop(), ((0, -rows % side), (0, -cols % side)))
    split = whole.reshape(whole.shape[0] // side, side, whole.shape[1] // side, side).transpose(1, 3, 0, 2)
    return np.stack(fine), np.ascontiguousarray(np.pad(split, ((0, 0), (0, 0), (0, 1), (_STRIP, 0))))


def correlate(
    fine: Bytes, top: Bytes, ends: FloatArray, headings: FloatArray, window: tuple[int, int, int, int],
    centre: FloatArray, information: FloatArray, distance: float, places: int, floor: int, rival: float,
    apart_cells: float, apart_rad: float,
) -> Int32Array:  # fmt: skip
    """The best lattice pose of a scan in a map, and the best ones that are other places.

    A lattice pose is the centre of a cell (x, y) with x0 <= x < x1 and y0 <= y < y1, and one of `headings` (A,). Its
    sum adds the likelihood of the cells that hold the scan's `ends`; of equal sums the first by (heading, y, x) is the
    better. Only poses whose way d from `centre` (3,) has d^T `information` d <= `distance`^2 are tried.

    Parameters
    ----------
    fine, top : arrays of `max_pyramid`
    ends : (B, 2) float64, cells
        From the scan's origin, B <= 256.
    window : (int, int, int, int)
        x0, x1, y0, y1: cells of the map.
    centre, information : (3,), (3, 3) float64
        In cells and rad, from the lower left corner of the map's cell (0, 0); headings are taken as they are given.
    places, floor : int
        How many places are wanted, and the least sum of each.
    rival : float
        Least part of the first place's sum that the others must have.
    apart_cells, apart_rad : float
        A pose within both of an earlier place is not another one.

    Returns
    -------
    (N, 4) int32
        [sum, heading's index, y, x] of at most `places` places, the best first.

    Source: Olson, Real-time correlative scan matching (ICRA 2009); Hess et al. 2016, Algorithm 3, of which the
    compiled twin is the best-first form.
    """
    poses = [np.zeros((0, 4), np.int64)]
    for index, heading in enumerate(headings.tolist()):
        sums = np.where(
            _within(window, heading, centre, information, distance), _sums(fine, ends, heading, window), -1
        )
        y, x = np.nonzero(sums >= max(floor, 0))
        poses.append(np.column_stack([sums[y, x], np.full(len(y), index), y + window[2], x + window[0]]))
    left = np.concatenate(poses)
    left = left[np.argsort(-left[:, 0], kind="stable")]
    found: list[IntArray] = []
    while len(left) and len(found) < places:
        place = left[0]
        found.append(place)
        turns = np.array([abs(math.remainder(h - headings[place[1]], 2 * math.pi)) for h in headings.tolist()])
        squared = ((left[:, 2:] - place[2:]) ** 2).sum(axis=1)
        other = (turns[left[:, 1]] > apart_rad) | (squared > apart_cells**2)
        left = left[other & (left[:, 0] >= rival * found[0][0])]
    return np.array(found, dtype=np.int32).reshape(-1, 4)


def _sums(fine: Bytes, ends: FloatArray, heading: float, window: tuple[int, int, int, int]) -> IntArray:
    """Sums (y1 - y0, x1 - x0) of the window's poses with one heading."""
    (x0, x1, y0, y1), border = window, 2 ** len(fine)
    likelihood = fine[0, border:-border, border:-border]
    height, width = likelihood.shape
    c, s = math.cos(heading), math.sin(heading)
    dx = np.floor(c * ends[:, 0] - s * ends[:, 1] + 0.5).astype(np.int64)
    dy = np.floor(s * ends[:, 0] + c * ends[:, 1] + 0.5).astype(np.int64)
    sums = np.zeros((y1 - y0, x1 - x0), np.int64)
    for x, y in zip(dx.tolist(), dy.tolist(), strict=True):
        # The poses from which this end lies inside the map
        left, right, low, high = max(x0, -x), min(x1, width - x), max(y0, -y), min(y1, height - y)
        if left < right and low < high:
            sums[low - y0 : high - y0, left - x0 : right - x0] += likelihood[low + y : high + y, left + x : right + x]
    return sums


def _within(
    window: tuple[int, int, int, int], heading: float, centre: FloatArray, information: FloatArray, distance: float
) -> NDArray[np.bool_]:
    """Which of the window's poses (y1 - y0, x1 - x0) with one heading are within `distance` of `centre`."""
    x0, x1, y0, y1 = window
    x, y = np.arange(x0, x1) + 0.5 - centre[0], (np.arange(y0, y1) + 0.5 - centre[1])[:, None]
    t, m = heading - centre[2], information
    form = x * (m[0, 0] * x + 2 * (m[0, 1] * y + m[0, 2] * t)) + y * (m[1, 1] * y + 2 * m[1, 2] * t) + m[2, 2] * t * t
    inside: NDArray[np.bool_] = form <= distance * distance
    return inside
