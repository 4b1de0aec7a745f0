"""How well the surfaces of scans fit each other, in plain NumPy."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["match_surfaces", "rank_bearings"]

Numbers = NDArray[np.float64]
Places = NDArray[np.int64]

BESIDE = 3
"""Points on either side of a bearing among which the nearest is searched."""
NEAR_M = 0.5
LEAST_COSINE = 0.9
"""Of the angle between normals of one surface."""


def rank_bearings(ways: Numbers) -> Numbers:
    """Numbers (B,) from -2 to 2 that ascend with the bearings of ways (B, 2) from -pi to pi."""
    x, y = ways.T
    size = np.abs(x) + np.abs(y)
    rank = np.divide(y, size, out=np.zeros(len(y)), where=size > 0)
    return np.asarray(np.where(x >= 0, rank, np.where(y >= 0, 2.0 - rank, -2.0 - rank)), np.float64)


def match_surfaces(
    points: Numbers,
    normals: Numbers,
    bearings: Numbers,
    starts: Places,
    origins: Numbers,
    poses: Numbers,
    pairs: Places,
    gate_m: float,
    scale_m: float,
    both: bool,
) -> Numbers:
    """Normal equations of the relative poses of pairs of scans, point to line (Chen and Medioni 1992).

    A point is matched with the nearest one among those of about the same bearing, where normals agree. The residual is
    its distance along the other's normal, with a Cauchy weight.

    Parameters
    ----------
    points, normals : (B, 2) float64
        Of S scans, base frame; scan s has those from starts[s] to starts[s + 1] - 1.
    bearings : (B,) float64
        Ranks of the bearings of the points from the laser (`rank_bearings`), ascending within a scan.
    starts, origins : (S + 1,) int64, (S, 2) float64
        Where scans begin, and where their lasers are.
    poses : (S, 3) float64
        Where the scans are, map frame.
    pairs : (P, 2) int64
        Scans `from` and `to`.
    gate_m, scale_m : float, m
        Largest residual, and that of which the weight is a half.
    both : bool
        Whether points of `from` are matched with lines of `to`, too, or only those of `to` with lines of `from`.

    Returns
    -------
    (P, 10) float64
        By the error e of the pose of `to` seen from `from`, in the frame of `to` (`PoseGraph.errors`): the sums of
        w g g' (upper triangle, row by row) and of w g r, for slopes g = dr/de; and the number of matched points.
    """
    out = np.zeros((len(pairs), 10))
    for row, (from_, to) in zip(out, pairs.tolist(), strict=True):
        for fixed, moved in ((from_, to), (to, from_))[: 1 + both]:
            x, y, turn = (poses[moved] - poses[fixed]).tolist()
            c, s = np.cos(poses[fixed, 2]), np.sin(poses[fixed, 2])
            x, y = c * x + s * y, c * y - s * x
            c, s = np.cos(turn), np.sin(turn)
            turned = np.array([[c, s], [-s, c]])
            own = slice(starts[moved], starts[moved + 1])
            first, last = int(starts[fixed]), int(starts[fixed + 1])
            if first == last:
                continue
            at = points[own] @ turned + [x, y]
            place = first + np.searchsorted(bearings[first:last], rank_bearings(at - origins[fixed]))
            near = place[:, None] + np.arange(-BESIDE, BESIDE)
            is_there = (near >= first) & (near < last)
            away = np.square(at[:, None] - points[np.clip(near, first, last - 1)]).sum(axis=2)
            away[~is_there] = np.inf
            best = away.argmin(axis=1)
            line = np.clip(near[np.arange(len(near)), best], first, last - 1)
            residual = ((at - points[line]) * normals[line]).sum(axis=1)
            fits = away.min(axis=1, initial=np.inf) < NEAR_M**2
            fits &= (normals[line] * (normals[own] @ turned)).sum(axis=1) >= LEAST_COSINE
            fits &= np.abs(residual) <= gate_m
            slope = -np.column_stack([normals[line], normals[line, 1] * at[:, 0] - normals[line, 0] * at[:, 1]])
            if moved == to:
                towards = normals[line] @ turned.T
                lever = towards[:, 1] * points[own, 0] - towards[:, 0] * points[own, 1]
                slope = np.column_stack([towards, lever])
            slope, residual = slope[fits], residual[fits]
            weighted = slope / (1 + np.square(residual / scale_m))[:, None]
            row[:6] += (weighted.T @ slope)[np.triu_indices(3)]
            row[6:9] += weighted.T @ residual
            row[9] += len(residual)
    return out
