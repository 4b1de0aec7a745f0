"""Conversion of pose covariances in ROS messages to covariances of the motion between scans."""

from __future__ import annotations

from bisect import bisect_right
from typing import final

import numpy as np

from gridslam.arguments import is_covariance
from gridslam.geometry.compounding import compound_covariance, increment_covariance
from gridslam.geometry.se2 import between, compose, exp, log
from gridslam.io.bags.ros_messages import Triangle
from gridslam.types import FloatArray

__all__ = ["PoseCovariances"]

_KEEP_NS = 5_000_000_000
_STILL = 1e-3  # m and rad: noise of no more motion is not seen
_FLOOR = 1e-8 * np.eye(3)  # of a robot that stands: a tenth of a millimetre and of a milliradian
_MOST = 1.0  # m^2 and rad^2, from one reading to the next: no odometry is so bad
_PROOF = 3  # readings in a row that must have grown before one is used: drivers switch between two constants, too
_HUGE = 1e12  # of a pose: such a number, or infinity, often means unknown


@final
class PoseCovariances:
    """Processes poses with covariances in order, and returns the covariance of the motion between them.

    In nav_msgs/Odometry the covariance is that of the pose since the odometry began, so it grows from reading to
    reading by the noise of the motion. Many drivers send zeros, a constant, or huge numbers for what they do not know,
    and a filter with an absolute heading does not grow either: a covariance that does not grow by a covariance
    while the robot moves has no information on the motion, and is left out.
    """

    def __init__(self) -> None:
        self._stamps_ns: list[int] = []
        self._poses: list[FloatArray] = []
        self._noises: list[FloatArray | None] = []  # of the motion up to each reading
        self._last: Triangle | None = None
        self._grown = 0

    def add(self, stamp_ns: int, pose: FloatArray, covariance: Triangle | None) -> None:
        """Add a reading: pose (3,) in the odometry frame and its covariance; None if unknown."""
        if covariance is not None and not all(abs(value) < _HUGE for value in covariance):
            covariance = None
        last, self._last = self._last, covariance
        if covariance is None or last is None or stamp_ns <= self._stamps_ns[-1]:
            self._begin(stamp_ns, pose, covariance)
            return
        self._noises.append(self._noise(self._poses[-1], _full(last), pose, _full(covariance), last == covariance))
        self._stamps_ns.append(stamp_ns)
        self._poses.append(pose)
        if self._stamps_ns[0] < stamp_ns - 2 * _KEEP_NS:
            gone = bisect_right(self._stamps_ns, stamp_ns - _KEEP_NS)
            del self._stamps_ns[:gone], self._poses[:gone], self._noises[:gone]

    def between(self, begin_ns: int, end_ns: int) -> FloatArray | None:
        """Covariance (3, 3) of the motion from one stamp to another, in the base frame at the first; None: unknown."""
        stamps = self._stamps_ns
        if not stamps or not stamps[0] <= begin_ns < end_ns <= stamps[-1]:
            return None
        moved, covariance = np.zeros(3), np.zeros((3, 3))
        for k in range(bisect_right(stamps, begin_ns), len(stamps)):
            start, stop, noise = stamps[k - 1], stamps[k], self._noises[k]
            if noise is None:
                return None
            share = (min(stop, end_ns) - max(start, begin_ns)) / (stop - start)
            increment = exp(share * log(between(self._poses[k - 1], self._poses[k])))
            covariance = compound_covariance(moved, covariance, increment, share * noise)
            moved = compose(moved, increment)
            if stop >= end_ns:
                break
        return covariance if is_covariance(covariance) else None

    def _begin(self, stamp_ns: int, pose: FloatArray, covariance: Triangle | None) -> None:
        known = covariance is not None
        self._stamps_ns, self._poses, self._noises = ([stamp_ns], [pose], [None]) if known else ([], [], [])
        self._grown = 0

    def _noise(
        self, before: FloatArray, known: FloatArray, pose: FloatArray, covariance: FloatArray, same: bool
    ) -> FloatArray | None:
        """Noise of the motion between two readings, if the covariances of their poses determine it."""
        increment = between(before, pose)
        if np.abs(increment).max() <= _STILL and (same or np.abs(covariance - known).max() <= _FLOOR[0, 0]):
            return _FLOOR if self._grown >= _PROOF else None
        noise = None if same else increment_covariance(before, known, increment, covariance)
        grows = noise is not None and is_covariance(noise) and float(np.diagonal(noise).max()) <= _MOST
        self._grown = self._grown + 1 if grows else 0
        return noise if self._grown >= _PROOF else None


def _full(triangle: Triangle) -> FloatArray:
    xx, xy, xt, yy, yt, tt = triangle
    return np.array([[xx, xy, xt], [xy, yy, yt], [xt, yt, tt]])
