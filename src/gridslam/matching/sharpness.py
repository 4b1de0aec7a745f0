"""Sharpness of walls: how far the ends of beams are from the surfaces that other visits have seen."""

from __future__ import annotations

import numpy as np

from gridslam.matching.surfaces import Surfaces
from gridslam.types import FloatArray, IntArray

_STEP_M = 0.3
"""Way between two scans that are compared with others: where the robot stood counts once."""
_REACH_M = 5.0
"""Distance of two scans that are compared, at most."""
_WAY_M = 15.0
"""Way between two visits, at least: the tracker alone is exact over less."""
_VISITS = 5
"""Earlier scans, the nearest ones, with which each is compared."""
_GATE_M = 0.3
"""Distance from a surface beyond which a point belongs to another one, or to something that was moved."""
_FEWEST_POINTS = 100


def measure_sharpness(surfaces: Surfaces, poses: FloatArray) -> float | None:
    """Return the rms distance (m) of points to the surfaces that other visits of a place have seen.

    That of exact poses is the noise of two beams, 1.4 times that of one: as thick are walls that were seen twice.

    Parameters
    ----------
    surfaces : Surfaces
        Of scans in the order in which they were taken.
    poses : (S, 3) float64
        Where they were.

    Returns
    -------
    float or None
        None where nothing was visited twice.
    """
    pairs = _select_visits(poses)
    found = surfaces.match(poses, pairs, _GATE_M, _GATE_M, both=False)
    points = int(found.counts.sum())
    return float(np.sqrt(found.squares.sum() / points)) if points >= _FEWEST_POINTS else None


def _select_visits(poses: FloatArray) -> IntArray:
    """Select pairs (P, 2) of scans at poses (S, 3) that were taken near each other on different visits."""
    ways = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))])
    _, chosen = np.unique(np.floor(ways / _STEP_M), return_index=True)
    places = poses[chosen, :2]
    pairs: list[tuple[int, int]] = []
    for place, to in zip(places, chosen.tolist(), strict=True):
        earlier = int(np.searchsorted(ways[chosen], ways[to] - _WAY_M, side="right"))
        away = np.hypot(*(places[:earlier] - place).T)
        near = np.flatnonzero(away < _REACH_M)
        nearest = near[np.argsort(away[near], kind="stable")[:_VISITS]]
        pairs += [(from_, to) for from_ in chosen[nearest].tolist()]
    return np.array(pairs, np.int64).reshape(-1, 2)
