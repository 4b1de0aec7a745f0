"""Episodes of wheel slip."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gridslam.doctor.calibration import MotionCalibration
from gridslam.doctor.laser_motion import LaserMotion
from gridslam.geometry.se2 import between
from gridslam.types import FloatArray, IntArray

__all__ = ["Slip", "wheel_slips"]

_SUSPECT = np.array([0.06, 0.1])  # m, rad of an interval beyond what is explained: and `_SIGMAS` deviations
_SIGMAS = 5.0
_EPISODE = np.array([0.15, 0.25])  # m, rad of a whole episode
_DETERMINED = np.array([0.028, 0.02])  # m, rad: greatest standard deviation of the laser's own increment
_AROUND_S = 2.0  # what is made up for so soon was no slip: a message came late, or a match was wrong for a moment
_KEPT = 0.6
_MOSTLY = 0.75  # of the episodes have too much odometry: if as many have too little, it jitters
_LEAP_M = 0.3  # larger jumps of odometry from one scan to the next: scans are missing, and the laser may be wrong


class Slip(NamedTuple):
    """One episode: start, duration, and the excess of the odometry over the true motion (signed)."""

    stamp_ns: int
    duration_s: float
    metres: float
    radians: float


def wheel_slips(motion: LaserMotion, calibration: MotionCalibration) -> list[Slip]:
    """Find episodes in the residuals of a calibration, by the time they began.

    Intervals in which the laser does not determine its motion well take no part. Wheels that slip turn more than the
    robot moves; a log whose odometry is as often too small has another fault than slip.
    """
    parts, residuals = calibration.intervals, calibration.residuals[:, [0, 2]]
    if not len(parts):
        return []
    spread = np.sqrt(np.diagonal(parts.covariances, axis1=1, axis2=2))
    known = np.stack([spread[:, :2].max(axis=1), spread[:, 2]], axis=1) < _DETERMINED
    even = _even(motion.odometry, parts.begins, parts.ends)
    residuals = np.where(known & even[:, None], residuals, 0.0)
    times = motion.stamps_ns[parts.begins] * 1e-9
    until = motion.stamps_ns[parts.ends] * 1e-9
    suspect = (np.abs(residuals) > np.maximum(_SUSPECT, _SIGMAS * np.nan_to_num(calibration.noise))).any(axis=1)
    found: list[Slip] = []
    short = 0
    for first, last in _runs(suspect, times, until):
        amount = residuals[max(first - 1, 0) : last + 2].sum(axis=0)  # it begins and ends within an interval
        around = (times > times[first] - _AROUND_S) & (until < until[last] + _AROUND_S)
        net = residuals[around].sum(axis=0)
        large = (np.abs(amount) > _EPISODE) & (net / np.where(amount == 0, 1.0, amount) > _KEPT)
        if not large.any():
            continue
        told = parts.odometry[first : last + 1, ::2].sum(axis=0)
        if (amount * told)[large].max() <= 0:
            short += 1
        else:
            stamp_ns = int(motion.stamps_ns[parts.begins[first]])
            found.append(Slip(stamp_ns, float(until[last] - times[first]), float(amount[0]), float(amount[1])))
    return found if len(found) >= _MOSTLY * (len(found) + short) else []


def _even(odometry: FloatArray, begins: IntArray, ends: IntArray) -> NDArray[np.bool_]:
    """Whether odometry moves evenly enough from scan to scan, in each of N intervals and just before it."""
    steps = np.nan_to_num(between(odometry[:-1], odometry[1:])[:, :2])
    leaps = np.concatenate([[False], np.hypot(*np.diff(steps, axis=0).T) > _LEAP_M, [False]])
    before = np.concatenate([[0], np.cumsum(leaps)])
    even: NDArray[np.bool_] = before[np.minimum(ends + 1, len(before) - 1)] == before[np.maximum(begins - 1, 0)]
    return even


def _runs(suspect: NDArray[np.bool_], times: NDArray[Any], until: NDArray[Any]) -> list[tuple[int, int]]:
    """First and last of suspect intervals that follow one another without a pause."""
    runs: list[tuple[int, int]] = []
    for index in np.flatnonzero(suspect).tolist():
        if runs and runs[-1][1] == index - 1 and times[index] - until[index - 1] < 0.5:
            runs[-1] = (runs[-1][0], index)
        else:
            runs.append((index, index))
    return runs
