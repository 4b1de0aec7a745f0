"""A log cut into intervals of motion, each seen by the laser and by odometry."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray

from gridslam.doctor.laser_motion import LaserMotion
from gridslam.geometry.angles import wrap
from gridslam.geometry.se2 import adjoint, between
from gridslam.types import FloatArray, IntArray

_LONGEST_S = 3.0
_LEAST_SHARE = 0.5
_MOVED = 0.03  # m, and rad: an interval with less motion holds no information


@final
@dataclass(frozen=True, slots=True, eq=False)
class Intervals:
    """Increments over N intervals that follow one another.

    Attributes
    ----------
    begins, ends : (N,) int64
        Indices of matched scans.
    laser : (N, 3) float64
        Pose of the laser at the end seen from the begin.
    covariances : (N, 3, 3) float64
        Of `laser`.
    odometry : (N, 3) float64
        Pose of the base at the end relative to the begin, by odometry.
    """

    begins: IntArray
    ends: IntArray
    laser: FloatArray
    covariances: FloatArray
    odometry: FloatArray

    def __len__(self) -> int:
        """Return the number of intervals N."""
        return len(self.begins)

    def __getitem__(self, chosen: NDArray[np.bool_]) -> Intervals:
        """Return the intervals chosen (N,)."""
        return Intervals(*(getattr(self, name)[chosen] for name in self.__slots__))


def intervals(motion: LaserMotion, odometry: FloatArray, reach: tuple[float, float, float]) -> Intervals:
    """Split the motion where `reach` (metres, radians, seconds) is exceeded; keep tracked intervals with motion.

    `odometry` (K, 3) is the motion's own, or that at other times.
    """
    seconds = np.clip(np.diff(motion.stamps_ns) * 1e-9, 0, None)
    steps = np.abs(between(motion.poses[:-1], motion.poses[1:])) if len(motion) > 1 else np.zeros((0, 3))
    used = np.hypot(steps[:, 0], steps[:, 1]) / reach[0] + steps[:, 2] / reach[1] + seconds / reach[2]
    whole = np.floor(np.concatenate([[0.0], np.cumsum(used)]))
    cuts = np.flatnonzero(np.diff(whole, prepend=-1.0))
    begins = cuts[:-1]
    ends = cuts[1:]
    passed = (motion.stamps_ns[ends] - motion.stamps_ns[begins]) * 1e-9
    tracked = (motion.tracks[begins] == motion.tracks[ends]) & (passed > 0) & (passed < _LONGEST_S)
    share = np.where(motion.shares == 0, 1.0, motion.shares)
    tracked &= np.minimum(share[begins], share[ends]) > _LEAST_SHARE
    tracked &= np.isfinite(odometry[begins]).all(axis=1) & np.isfinite(odometry[ends]).all(axis=1)
    begins = begins[tracked]
    ends = ends[tracked]
    laser = between(motion.poses[begins], motion.poses[ends])
    driven = between(odometry[begins], odometry[ends])
    reported = np.maximum(np.abs(laser), np.abs(driven))
    moved = (np.hypot(reported[:, 0], reported[:, 1]) > _MOVED) | (reported[:, 2] > _MOVED)
    from_begin = adjoint(laser * [-1.0, -1.0, 0.0])  # the two poses err independently, in the laser's frame at each
    from_end = adjoint(laser * [0.0, 0.0, 1.0])
    covariances = from_begin @ motion.covariances[begins] @ from_begin.transpose(0, 2, 1)
    covariances += from_end @ motion.covariances[ends] @ from_end.transpose(0, 2, 1)
    return Intervals(begins, ends, laser, covariances, driven)[moved]


def cumulative_headings(poses: FloatArray) -> FloatArray:
    """Unwrap the headings (K,) of poses (K, 3); values that are not finite count as no rotation."""
    return np.concatenate([[0.0], np.cumsum(np.nan_to_num(wrap(np.diff(poses[:, 2]))))])


def interpolate_odometry(motion: LaserMotion, seconds: float) -> FloatArray:
    """Odometry (K, 3) at times that lie `seconds` before the poses', by cubic interpolation; NaN beyond its ends.

    Headings are not wrapped. Stamps that go backward hold still.
    """
    known = np.isfinite(motion.odometry).all(axis=1)
    poses = motion.odometry.copy()
    poses[known, 2] = poses[known, 2][:1] + cumulative_headings(poses[known])
    if seconds == 0.0 and np.array_equal(motion.stamps_ns, motion.odometry_stamps_ns):
        return poses
    first_ns = motion.odometry_stamps_ns[:1]
    reported = np.maximum.accumulate((motion.odometry_stamps_ns - first_ns) * 1e-9)
    fresh = known & (np.diff(reported, prepend=-1.0) > 0)
    if fresh.sum() < 3:
        return np.full_like(poses, np.nan)
    seen = np.maximum.accumulate((motion.stamps_ns - first_ns) * 1e-9)
    columns = [np.interp(seen - seconds, reported[fresh], some, math.nan, math.nan) for some in poses[fresh].T]
    return np.stack(columns, axis=1)
