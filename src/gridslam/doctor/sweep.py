"""How long a laser takes for a scan, told by the turns that its scans show.

A scan that takes `sweep_s` for its field of view, on a robot that turns at `rate`, shows bearings stretched by
1 + rate * sweep_s / field of view (beams counter-clockwise): turns against the sweep then look larger in the scans
than they are, and turns with it smaller, while odometry knows both. That difference of left and right is fitted.
"""

from __future__ import annotations

import math

import numpy as np

from gridslam.doctor.calibration import Estimate
from gridslam.doctor.intervals import cumulative_headings, intervals, shifted
from gridslam.doctor.laser_motion import LaserMotion
from gridslam.doctor.robust_fit import robust_fit
from gridslam.types import FloatArray

__all__ = ["measured_sweep", "turn_rates"]

_REACH = (0.4, 0.25, 0.4)  # metres, radians, seconds of an interval: short, for rates to be even in it
_FEWEST = 20
_ODOMETRY = (1e-4, 2e-4)  # variances of its heading per metre and per radian, rad^2
_RATE_OVER_S = 0.3  # a rate is the turn over so long


def turn_rates(motion: LaserMotion) -> FloatArray:
    """Turn rates (K,) of the laser, rad/s, by differences over about 0.3 s; 0 at the ends."""
    rates = np.zeros(len(motion))
    if len(motion) < 3:
        return rates
    times = np.maximum.accumulate((motion.stamps_ns - motion.stamps_ns[0]) * 1e-9)
    apart = max(1, round(_RATE_OVER_S / 2 / max(float(np.median(np.diff(times))), 1e-3)))
    if len(motion) <= 2 * apart:
        return rates
    headings = cumulative_headings(motion.poses)
    passed, turned = times[2 * apart :] - times[: -2 * apart], headings[2 * apart :] - headings[: -2 * apart]
    same = motion.tracks[2 * apart :] == motion.tracks[: -2 * apart]
    rates[apart:-apart] = np.where(same & (passed > 0), turned / np.maximum(passed, 1e-3), 0.0)
    return rates


def measured_sweep(motion: LaserMotion, field_of_view_rad: float, *, reflected: bool = False) -> Estimate:
    """Time in s that a scan takes for its field of view, as the turns tell; positive for beams counter-clockwise.

    Matching against a map that earlier scans drew hides up to half of it: it tells whether a laser sweeps, and only
    roughly for how long. Not determined where there are too few turns, or odometry is missing.
    """
    if len(motion) < _FEWEST:
        return Estimate(0.0)
    odometry, sign = shifted(motion, 0.0), -1.0 if reflected else 1.0
    parts = intervals(motion, odometry, _REACH)
    if len(parts) < _FEWEST:
        return Estimate(0.0)
    headings, rates = sign * cumulative_headings(motion.poses), sign * turn_rates(motion)
    turned = headings[parts.ends] - headings[parts.begins]
    seconds = (motion.stamps_ns[parts.ends] - motion.stamps_ns[parts.begins]) * 1e-9
    way = np.copysign(np.hypot(parts.odometry[:, 0], parts.odometry[:, 1]), parts.odometry[:, 0])
    sigma = np.sqrt(parts.covariances[:, 2, 2] + _ODOMETRY[0] * np.abs(way) + _ODOMETRY[1] * np.abs(turned))
    lag = rates[parts.ends] - rates[parts.begins]
    design = np.stack([turned, way, lag, turned * turned / seconds], axis=1) / sigma[:, None]
    told = odometry[parts.ends, 2] - odometry[parts.begins, 2]
    fit = robust_fit(design[:, None, :], (told / sigma)[:, None])
    if not abs(fit.parameters[0]) > 0.2:
        return Estimate(0.0)
    by = sign * field_of_view_rad / float(fit.parameters[0])
    spread = math.sqrt(max(float(fit.covariance[3, 3]), 0.0)) * abs(by)
    return Estimate(float(fit.parameters[3]) * by, spread, bool(np.abs(turned).sum() > math.pi))
