"""The full-SLAM answer: a pose for every scan from the poses at the key scans and the tracked motion between them."""

from __future__ import annotations

import numpy as np

from gridslam.geometry.angles import wrap
from gridslam.geometry.se2 import between, compose
from gridslam.types import FloatArray, IntArray

__all__ = ["full_trajectory", "path_fractions"]


def full_trajectory(key_poses: FloatArray, keys: IntArray, key_from_base: FloatArray) -> FloatArray:
    """Poses (N, 3) of all scans, bent so that the tracked motion ends where the next key scan lies.

    The tracker's error is a random walk that grows with the motion. Given both ends its mean is a bridge: of what the
    motion from one key scan misses the next one by, a scan takes the share of the metres and radians driven so far.

    Parameters
    ----------
    key_poses : (T, 3) float64
        Poses at the key scans, of one particle.
    keys : (N,) int64
        For each scan the key scan at or before it, from 0; the first scan is a key scan.
    key_from_base : (N, 3) float64
        The tracked motion since the key scan *before* each scan, as `StepReport` gives it.

    Source: the mean of a Brownian bridge; a tracker between nodes of a trajectory as in Haehnel et al. 2003.
    """
    arrivals = _find_later_key_scans(keys)
    since = _motion_since_key_scan(key_from_base, arrivals)
    residual = np.zeros_like(key_poses)
    residual[:-1] = between(compose(key_poses[:-1], key_from_base[arrivals]), key_poses[1:])
    fraction = path_fractions(keys, key_from_base)
    return compose(compose(key_poses[keys], since), fraction[:, None] * residual[keys])


def path_fractions(keys: IntArray, key_from_base: FloatArray) -> FloatArray:
    """Fraction of the path from its key scan to the next one for each scan: (N,) in [0, 1].

    In metres and radians driven; after the last key scan it is these themselves. Arguments as for `full_trajectory`.
    """
    arrivals = _find_later_key_scans(keys)
    steps = key_from_base[1:] - _motion_since_key_scan(key_from_base, arrivals)[:-1]
    moved = np.hypot(steps[:, 0], steps[:, 1]) + np.abs(wrap(steps[:, 2]))
    driven = np.concatenate([[0.0], np.cumsum(moved)])
    starts = driven[np.append(0, arrivals)]
    whole = np.append(np.maximum(np.diff(starts), 1e-12), 1.0)
    fraction: FloatArray = (driven - starts[keys]) / whole[keys]
    return fraction


def _find_later_key_scans(keys: IntArray) -> IntArray:
    """Which scans are key scans, without the first."""
    return np.flatnonzero(np.diff(keys) > 0) + 1


def _motion_since_key_scan(key_from_base: FloatArray, arrivals: IntArray) -> FloatArray:
    """The tracked motion (N, 3) since the key scan at or before each scan."""
    since = key_from_base.copy()
    since[0] = since[arrivals] = 0.0
    return since
