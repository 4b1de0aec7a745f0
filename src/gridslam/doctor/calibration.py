"""Odometry and mounting calibrated together against the motion of the laser.

A robot whose odometry reports `scale` metres for each metre, `turn_scale` radians for each radian and `drift_rad_per_m`
radians more for each metre, with a laser at (x, y, yaw) whose scans are stamped `skew_s` s late, gives

    odometry turn(t)  = turn_scale * turn(t + skew) + drift * metres(t + skew)
    odometry path     = scale * (R(yaw) path of the laser - (R(turn) - 1) (x, y))

which is linear but for the skew. The laser is the more exact of the two, so it stands on the right: noise on that side
would make all factors come out too small.

Source: Censi, Franchi, Marchionni, Oriolo, Simultaneous calibration of odometry and sensor parameters for mobile robots
(T-RO 2013), with the wheels' radii and distance replaced by what odometry makes of them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import final

import numpy as np

from gridslam.doctor.estimate import DETERMINED, FEWEST, LEAST_SPREAD, VARIANCES, ParameterEstimate, estimate_parameter
from gridslam.doctor.intervals import Intervals, interpolate_odometry, intervals
from gridslam.doctor.laser_motion import LaserMotion
from gridslam.doctor.robust_fit import robust_fit
from gridslam.doctor.turns import fit_turns
from gridslam.geometry.angles import wrap
from gridslam.types import FloatArray

__all__ = ["MotionCalibration", "ParameterEstimate", "calibrate"]

_WAYS = (0.5, 0.6, 2.0)
_SCALE_FLOOR = 0.002  # scan matching itself: see `laser_odometry`


@final
@dataclass(frozen=True, slots=True, eq=False)
class MotionCalibration:
    """Calibration of odometry and mounting from the motion of a laser.

    Attributes
    ----------
    reflected : bool
        The beams are read in the wrong direction: laser and odometry turn opposite ways.
    agreement : float
        Correlation of the turns of laser and odometry in [-1, 1], negative for a reflected laser; NaN where there are
        too few turns.
    scale, turn_scale : ParameterEstimate
        Measured metres per true metre, measured radians per true radian.
    drift_rad_per_m : ParameterEstimate, rad/m
        What odometry turns too much to the left for each metre driven forward.
    yaw_rad : ParameterEstimate, rad
        How far the laser is turned to the left beyond what the log declares, in [-pi, pi).
    skew_s : ParameterEstimate, s
        How late scans are stamped on the odometry's clock.
    x_m, y_m : ParameterEstimate, m
        The laser's place in the base frame.
    laser_m, laser_rad, odometry_m, odometry_rad : float
        Way and turns of both, over the intervals that could be compared.
    mounting : (3,) float64
        Pose of the laser as declared.
    intervals : Intervals
        Of the ways; and
    residuals : (N, 3) float64
        Residual of the odometry after calibration: x and y in m in the base frame, rad.
    noise : (2,) float64
        Standard deviations of the residuals of an interval, m and rad.
    """

    reflected: bool
    agreement: float
    scale: ParameterEstimate
    turn_scale: ParameterEstimate
    drift_rad_per_m: ParameterEstimate
    yaw_rad: ParameterEstimate
    skew_s: ParameterEstimate
    x_m: ParameterEstimate
    y_m: ParameterEstimate
    laser_m: float
    laser_rad: float
    odometry_m: float
    odometry_rad: float
    mounting: FloatArray
    intervals: Intervals
    residuals: FloatArray
    noise: FloatArray


def calibrate(motion: LaserMotion) -> MotionCalibration:
    """Compare a laser's motion with its odometry; estimates that the log does not determine are marked."""
    turns = fit_turns(motion)
    reflected = bool(turns.agreement < 0)
    odometry = interpolate_odometry(motion, turns.skew.value if turns.skew.determined else 0.0)
    ways = intervals(motion, odometry, _WAYS)
    sign = -1.0 if reflected else 1.0
    laser = ways.laser * [1.0, sign, sign]
    told = _chords(ways, laser)
    scale, yaw, x, y, predicted = _ways(told, laser, ways.covariances, sign, motion.mounting[2])
    residuals = np.empty((len(ways), 3))
    residuals[:, :2] = told - predicted
    way = np.hypot(ways.odometry[:, 0], ways.odometry[:, 1])
    turn_told = turns.turn_scale.value * laser[:, 2] + turns.drift.value * np.copysign(way, ways.odometry[:, 0])
    residuals[:, 2] = wrap(ways.odometry[:, 2] - turn_told)
    told_drift = turns.drift
    drift = ParameterEstimate(scale.value * told_drift.value, scale.value * told_drift.sigma, told_drift.determined)
    noise = np.array([_spread(np.hypot(*residuals[:, :2].T), 1.1774), _spread(np.abs(residuals[:, 2]), 0.6745)])
    return MotionCalibration(
        reflected, turns.agreement, scale, turns.turn_scale, drift, yaw, turns.skew, x, y,
        float(np.hypot(laser[:, 0], laser[:, 1]).sum()), float(np.abs(laser[:, 2]).sum()), float(way.sum()),
        float(np.abs(ways.odometry[:, 2]).sum()), motion.mounting, ways, residuals, noise,
    )  # fmt: skip


def _chords(ways: Intervals, laser: FloatArray) -> FloatArray:
    """Odometry of the paths (N, 2), corrected for the wrong rotation that bends them."""
    bend = -0.5 * wrap(ways.odometry[:, 2] - laser[:, 2])
    c, s, (x, y) = np.cos(bend), np.sin(bend), ways.odometry[:, :2].T
    return np.stack([c * x - s * y, s * x + c * y], axis=1)


def _spread(sizes: FloatArray, of_unit: float) -> float:
    return float(np.median(sizes)) / of_unit if len(sizes) else math.nan


def _ways(
    response: FloatArray, laser: FloatArray, covariances: FloatArray, sign: float, declared_yaw: float
) -> tuple[ParameterEstimate, ParameterEstimate, ParameterEstimate, ParameterEstimate, FloatArray]:
    """Scale, yaw offset and place of the laser, and the ways (N, 2) that they predict."""
    if len(laser) < FEWEST:
        nothing = ParameterEstimate(0.0)
        return ParameterEstimate(1.0), nothing, nothing, nothing, response.copy()
    design, mirror = _design(laser), np.array([1.0, sign])
    spread = covariances[:, :2, :2] * mirror[:, None] * mirror
    moved = np.hypot(response[:, 0], response[:, 1]) + np.abs(laser[:, 2])
    fit = robust_fit(design, response)
    for _ in range(2):
        c, s = fit.parameters[:2] / max(math.hypot(*fit.parameters[:2]), 1e-9)
        turn = np.array([[c, -s], [s, c]])
        noise = turn @ spread @ turn.T + (VARIANCES[1] * moved + 1e-6)[:, None, None] * np.eye(2)
        whiten = np.linalg.inv(np.linalg.cholesky(noise))
        fit = robust_fit(whiten @ design, np.einsum("nij,nj->ni", whiten, response), LEAST_SPREAD)
    a, b = fit.parameters[:2].tolist()
    scale, angle = max(math.hypot(a, b), 1e-6), math.atan2(b, a)
    c, s = math.cos(angle), math.sin(angle)
    along, across = np.array([c, s, 0, 0]), np.array([-s, c, 0, 0]) / scale
    sigma = [math.sqrt(max(float(g @ fit.covariance @ g), 0.0)) for g in (along, across)]
    sigma[0] = math.hypot(sigma[0], _SCALE_FLOOR)
    offset = float(wrap(angle - declared_yaw))
    x, y = (estimate_parameter(fit, k, DETERMINED["lever"] * min(scale, 1.0)) for k in (2, 3))
    x, y = (ParameterEstimate(e.value / scale, e.sigma / scale, e.determined) for e in (x, y))
    factor = ParameterEstimate(scale, sigma[0], sigma[0] < DETERMINED["scale"])
    yaw = ParameterEstimate(offset, sigma[1], sigma[1] < DETERMINED["yaw"])
    return factor, yaw, x, y, design @ fit.parameters


def _design(laser: FloatArray) -> FloatArray:
    """Design (N, 2, 4) of the ways: parameters scale cos(yaw), scale sin(yaw), scale x, scale y."""
    c, s = np.cos(laser[:, 2]), np.sin(laser[:, 2])
    return np.array([
        [laser[:, 0], -laser[:, 1], 1 - c, s],
        [laser[:, 1], laser[:, 0], -s, 1 - c],
    ]).transpose(2, 0, 1)  # fmt: skip
