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
from dataclasses import dataclass, replace
from typing import NamedTuple, final

import numpy as np

from gridslam.doctor.intervals import Intervals, cumulative_headings, interpolate_odometry, intervals
from gridslam.doctor.laser_motion import LaserMotion
from gridslam.doctor.mirrored_odometry import Mirrored, contradicts_its_heading, unmirror_odometry
from gridslam.geometry.angles import wrap
from gridslam.geometry.se2 import adjoint, transform_points
from gridslam.types import FloatArray

_FEWEST = 8  # intervals
_VARIANCES = (1e-4, 2e-4)  # of odometry: heading per metre and per radian (rad^2), way per metre and per radian (m^2)
_LEAST_SPREAD = 0.1  # of the residuals, in the standard deviations assumed
_DETERMINED = {"scale": 0.01, "turn_scale": 0.015, "drift": 0.004, "yaw": 0.03, "skew": 0.015}
"""Greatest standard deviations of determined values: a third or less of the errors that harm a map."""

_BRIEF = (0.8, 0.5, 0.8)  # metres, radians, seconds of an interval: as short as the time a turn takes
_LAG_PASSES = 12  # with few turns each step leaves a part of the rest
_TURNS = (1.5, 1.0, 2.0)  # long enough for odometry that comes late to catch up
_LAGS_S = np.arange(-1.0, 1.001, 0.05)
_UNEVEN = 0.6  # a pair of neighbours is farther apart than the usual by at most this share, or yields no turn rate
_BACKWARD = 0.01  # with a greater share of stamps that go backward, no skew can be estimated
_RATE_OVER_S = 0.3  # a turn rate is the turn over so long
_JITTER_S = 0.005  # of stamps, and what interpolation between them costs

_WAYS = (0.5, 0.6, 2.0)
_SCALE_FLOOR = 0.002  # scan matching itself

_SURE_OF_SIGN = 0.6  # correlation of the turns
_STEP_M = 0.1  # of odometry: shorter ways have no direction

_CONFUSED = 0.02  # tracks lost per scan, from which on the laser is no reference
_UNRELATED = 0.5  # correlation of the turns
_TURNED_RAD = 1.2  # one corner suffices
_DEGREES = math.degrees(1.0)
_FEWEST_TURNS = 12  # from scan to scan, of more than
_LEAST_TURN_RAD = 0.01  # which is most of a rad if it is read as degrees
_AGREE = 0.6  # mean cosine of differences of turns
_HARDLY_AGREE = 0.8

_CAUCHY = 2.385  # 95 % efficient for normal noise
_PASSES = 15
_MEDIAN_NORM = (0.6745, 1.1774)  # of a standard normal number, and of a vector of two
_BLOCKS = 25


class Fit(NamedTuple):
    """Parameters (P,), their covariance (P, P), and the norm of each residual (N,) in fitted standard deviations."""

    parameters: FloatArray
    covariance: FloatArray
    scores: FloatArray


def robust_fit(design: FloatArray, response: FloatArray, least_spread: float = 1e-9) -> Fit:
    """Fit response (N, D) = design (N, D, P) x parameters, D = 1 or 2, by Cauchy's M-estimator.

    The noise of each of the N terms has unit variance up to a common factor, which is estimated from the residuals by
    their median norm; it is `least_spread` at the least, or what a first bad guess leaves out might stay out. The
    covariance sums the scores of consecutive terms before it squares them, in `_BLOCKS` blocks, so that it holds
    whatever the true variances are and however neighbours correlate; parameters without any term have the variance of
    `least_spread`.

    Source: Huber and Ronchetti, Robust Statistics (2009), section 7; the sandwich with clusters is Liang and Zeger's
    (1986).
    """
    count, width, unknowns = design.shape
    weights = np.ones(count)
    for _ in range(_PASSES):
        normal = np.einsum("n,ndp,ndq->pq", weights, design, design)
        regular = normal + 1e-12 * np.trace(normal) * np.eye(unknowns) + 1e-300 * np.eye(unknowns)
        parameters = np.linalg.solve(regular, np.einsum("n,ndp,nd->p", weights, design, response))
        residuals = response - design @ parameters
        norms = np.sqrt(np.square(residuals).sum(axis=1))
        spread = max(float(np.median(norms)) / _MEDIAN_NORM[width - 1], least_spread)
        scores = norms / spread
        weights = 1 / (1 + np.square(scores / _CAUCHY))
    pulls = np.einsum("n,ndp,nd->np", weights, design, residuals)
    blocks = np.add.reduceat(pulls, np.arange(0, count, max(1, count // _BLOCKS)))
    flatter = max(float((weights * (2 * weights - 1)).sum() / weights.sum()), 0.3)
    inverse = np.linalg.inv(regular * flatter)
    sandwich = inverse @ (blocks.T @ blocks) @ inverse
    return Fit(parameters, sandwich + least_spread**2 * np.linalg.inv(regular), scores)


class ParameterEstimate(NamedTuple):
    """A value, its standard deviation (infinite if the log does not determine it) and whether that is small enough."""

    value: float
    sigma: float = math.inf
    determined: bool = False

    def differs(self, from_value: float, by: float, sigmas: float = 4.0) -> bool:
        """Whether the value is determined, and differs by more than `by` and than `sigmas` deviations from another."""
        return self.determined and abs(self.value - from_value) > max(by, sigmas * self.sigma)


def _determined(value: float, sigma: float, limit: float) -> ParameterEstimate:
    """Make an estimate that is determined where its deviation is below the limit."""
    return ParameterEstimate(value, sigma, sigma < limit)


def _estimate(fit: Fit, index: int, limit: float) -> ParameterEstimate:
    """Return one parameter of a fit."""
    return _determined(float(fit.parameters[index]), math.sqrt(max(fit.covariance[index, index], 0.0)), limit)


@final
@dataclass(frozen=True, slots=True, eq=False)
class MotionCalibration:
    """Calibration of odometry and mounting from the motion of a laser.

    Attributes
    ----------
    motion : LaserMotion
        What it was made from.
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
    laser_m, laser_rad, odometry_rad : float
        Way and turns of both, over the intervals that could be compared.
    mirrored : "", "heading" or "path"
        What of the odometry has the wrong sign, because its path contradicts its headings; all else is as without it.
    yaw_improves : bool
        Whether the ways agree with the odometry by `yaw_rad`, and do not as declared.
    headings_in_degrees : bool
        The headings of the odometry, read as rad, turn 57.3 times as far as the laser, to either side.
    is_reliable : bool
        Whether the laser could be followed: its track was hardly ever lost.
    """

    motion: LaserMotion
    reflected: bool
    agreement: float
    scale: ParameterEstimate
    turn_scale: ParameterEstimate
    drift_rad_per_m: ParameterEstimate
    yaw_rad: ParameterEstimate
    skew_s: ParameterEstimate
    laser_m: float
    laser_rad: float
    odometry_rad: float
    mirrored: Mirrored = ""
    yaw_improves: bool = False
    headings_in_degrees: bool = False
    is_reliable: bool = True

    @property
    def is_unrelated(self) -> bool:
        """Whether laser and odometry both turn, but not at the same times."""
        has_turned = min(self.laser_rad, self.odometry_rad) >= _TURNED_RAD
        return has_turned and abs(self.agreement) < _UNRELATED


def calibrate(motion: LaserMotion) -> MotionCalibration:
    """Compare a laser's motion with its odometry; estimates that the log does not determine are marked.

    Where the odometry's path contradicts its headings, the laser's turns decide which of the two is mirrored.
    """
    turns = _fit_turns(motion)
    mirrored: Mirrored = ""
    if abs(turns.agreement) > _SURE_OF_SIGN and contradicts_its_heading(motion.odometry):
        mirrored = "heading" if turns.agreement < 0 else "path"
        motion = replace(motion, odometry=unmirror_odometry(motion.odometry, mirrored))
        turns = _fit_turns(motion)
    reflected = bool(turns.agreement < 0)
    odometry = interpolate_odometry(motion, turns.skew.value if turns.skew.determined else 0.0)
    ways = intervals(motion, odometry, _WAYS)
    sign = -1.0 if reflected else 1.0
    laser = ways.laser * [1.0, sign, sign]
    reported = _chords(ways, laser)
    scale, yaw, predicted = _ways(reported, laser, ways.covariances, sign, motion.mounting[2])
    turn_drift = turns.drift
    drift = ParameterEstimate(scale.value * turn_drift.value, scale.value * turn_drift.sigma, turn_drift.determined)
    return MotionCalibration(
        motion,
        reflected,
        turns.agreement,
        scale,
        turns.turn_scale,
        drift,
        yaw,
        turns.skew,
        float(np.hypot(laser[:, 0], laser[:, 1]).sum()),
        float(np.abs(laser[:, 2]).sum()),
        float(np.abs(ways.odometry[:, 2]).sum()),
        mirrored,
        _improves(reported, predicted, yaw.value),
        are_degrees(*(np.diff(poses[:, 2])[np.diff(motion.tracks) == 0] for poses in (motion.odometry, motion.poses))),
        len(motion) >= 2 and int(motion.tracks[-1]) < max(3, _CONFUSED * len(motion)),
    )


def are_degrees(odometry: FloatArray, laser: FloatArray) -> bool:
    """Return whether turns (K,) of the odometry agree with those of the laser as degrees, and not as rad.

    Both are up to full turns, rad. In any healthy log they agree as rad, also where turns are alike, such that both
    readings fit.
    """
    known = np.isfinite(odometry) & (np.abs(laser) > _LEAST_TURN_RAD)
    if np.count_nonzero(known) < _FEWEST_TURNS:
        return False

    def agreement(unit: float) -> float:
        return max(float(np.cos(odometry[known] - sign * unit * laser[known]).mean()) for sign in (1, -1))

    return agreement(_DEGREES) > _AGREE and agreement(1.0) < _HARDLY_AGREE


def _improves(reported: FloatArray, predicted: FloatArray, yaw_rad: float) -> bool:
    """Return whether ways (N, 2) are as predicted with a yaw offset, and differ at least twice as much without it."""
    moved = np.hypot(*reported.T) > _STEP_M
    if np.count_nonzero(moved) < _FEWEST:
        return False
    declared = predicted @ adjoint([0.0, 0.0, yaw_rad])[:2, :2]
    with_offset, without = (float(np.median(np.hypot(*(reported - way)[moved].T))) for way in (predicted, declared))
    return 2 * with_offset < without


def _chords(ways: Intervals, laser: FloatArray) -> FloatArray:
    """Return odometry of the paths (N, 2), corrected for the wrong rotation that bends them."""
    bends = np.zeros_like(laser)
    bends[:, 2] = -0.5 * wrap(ways.odometry[:, 2] - laser[:, 2])
    return transform_points(bends, ways.odometry[:, :2])


def _ways(
    response: FloatArray, laser: FloatArray, covariances: FloatArray, sign: float, declared_yaw: float
) -> tuple[ParameterEstimate, ParameterEstimate, FloatArray]:
    """Scale and yaw offset of the laser, and the ways (N, 2) that they predict with its place."""
    if len(laser) < _FEWEST:
        return ParameterEstimate(1.0), ParameterEstimate(0.0), response.copy()
    design = _design(laser)
    mirror = np.array([1.0, sign])
    spread = covariances[:, :2, :2] * mirror[:, None] * mirror
    moved = np.hypot(response[:, 0], response[:, 1]) + np.abs(laser[:, 2])
    fit = robust_fit(design, response)
    for _ in range(2):
        c, s = fit.parameters[:2] / max(math.hypot(*fit.parameters[:2]), 1e-9)
        turn = np.array([[c, -s], [s, c]])
        noise = turn @ spread @ turn.T + (_VARIANCES[1] * moved + 1e-6)[:, None, None] * np.eye(2)
        whiten = np.linalg.inv(np.linalg.cholesky(noise))
        fit = robust_fit(whiten @ design, np.einsum("nij,nj->ni", whiten, response), _LEAST_SPREAD)
    a, b = fit.parameters[:2].tolist()
    scale = max(math.hypot(a, b), 1e-6)
    angle = math.atan2(b, a)
    c = math.cos(angle)
    s = math.sin(angle)
    along = np.array([c, s, 0, 0])
    across = np.array([-s, c, 0, 0]) / scale
    along_sigma, across_sigma = (math.sqrt(max(float(g @ fit.covariance @ g), 0.0)) for g in (along, across))
    factor = _determined(scale, math.hypot(along_sigma, _SCALE_FLOOR), _DETERMINED["scale"] * max(scale, 1.0))
    yaw = _determined(float(wrap(angle - declared_yaw)), across_sigma, _DETERMINED["yaw"])
    return factor, yaw, design @ fit.parameters


def _design(laser: FloatArray) -> FloatArray:
    """Design (N, 2, 4) of the ways: parameters scale cos(yaw), scale sin(yaw), scale x, scale y."""
    c = np.cos(laser[:, 2])
    s = np.sin(laser[:, 2])
    return np.array(
        [
            [laser[:, 0], -laser[:, 1], 1 - c, s],
            [laser[:, 1], laser[:, 0], -s, 1 - c],
        ]
    ).transpose(2, 0, 1)


class _Turns(NamedTuple):
    """Estimates from turns alone; the drift is per metre of odometry."""

    agreement: float
    turn_scale: ParameterEstimate
    drift: ParameterEstimate
    skew: ParameterEstimate


def _fit_turns(motion: LaserMotion) -> _Turns:
    """Fit turns; the skew is first the lag at which they agree best, then that at which its linear term vanishes."""
    nothing = _Turns(math.nan, ParameterEstimate(1.0), ParameterEstimate(0.0), ParameterEstimate(0.0))
    if len(motion) < _FEWEST:
        return nothing
    jittering = float((np.diff(motion.stamps_ns) < 0).mean()) > _BACKWARD
    lag, agreement = _best_lag(motion, np.zeros(1) if jittering else _LAGS_S)
    if math.isnan(agreement):
        return nothing
    sign = math.copysign(1.0, agreement)
    headings = cumulative_headings(motion.poses) * sign
    rates = np.zeros(len(motion)) if jittering else _rates(motion) * sign
    step, found = math.inf, None
    for _ in range(_LAG_PASSES):
        found = _fit_turns_at(motion, headings, rates, lag, _BRIEF)
        if found is None:
            return nothing
        step = float(np.clip(found.parameters[2] / max(abs(found.parameters[0]), 0.2), -0.1, 0.1))
        lag += step
    assert found is not None
    sigma = math.inf if jittering else math.sqrt(max(found.covariance[2, 2], 0.0))
    skew = ParameterEstimate(lag, sigma, sigma < _DETERMINED["skew"] and abs(step) < 0.01)
    fit = _fit_turns_at(motion, headings, rates, lag, _TURNS) or found
    drift = _estimate(fit, 1, _DETERMINED["drift"])
    return _Turns(agreement, _estimate(fit, 0, _DETERMINED["turn_scale"]), drift, skew)


def _best_lag(motion: LaserMotion, lags_s: FloatArray) -> tuple[float, float]:
    """Return the lag in s at which turns correlate best, and their correlation there; NaN where nothing turns."""
    best = 0.0
    agreement = math.nan
    parts = intervals(motion, interpolate_odometry(motion, 0.0), _BRIEF)
    if len(parts) < _FEWEST or np.abs(parts.laser[:, 2]).sum() < 1.0:
        return best, agreement
    for lag in sorted(lags_s.tolist(), key=abs):
        headings = interpolate_odometry(motion, lag)[:, 2]
        reported = headings[parts.ends] - headings[parts.begins]
        known = np.isfinite(reported)
        reported = reported[known]
        mine = parts.laser[known, 2]
        found = float(mine @ reported / max(math.sqrt(float(mine @ mine) * float(reported @ reported)), 1e-9))
        if math.isnan(agreement) or abs(found) > abs(agreement) + 1e-3:
            best = lag
            agreement = found
    return best, agreement


def _rates(motion: LaserMotion) -> FloatArray:
    """Turn rates (K,) of the laser, rad/s, by differences over about 0.3 s; NaN where stamps are uneven."""
    times = np.maximum.accumulate((motion.stamps_ns - motion.stamps_ns[:1]) * 1e-9)
    headings = cumulative_headings(motion.poses)
    apart = max(1, round(_RATE_OVER_S / 2 / max(float(np.median(np.diff(times))), 1e-3)))
    passed, turned = (values[2 * apart :] - values[: -2 * apart] for values in (times, headings))
    rates = np.full(len(motion), np.nan)
    even = np.abs(passed / max(float(np.median(passed)), 1e-9) - 1) < _UNEVEN if len(passed) else passed > 0
    rates[apart:-apart] = np.where(even, turned / np.maximum(passed, 1e-3), np.nan)
    return rates


def _fit_turns_at(
    motion: LaserMotion, headings: FloatArray, rates: FloatArray, lag: float, reach: tuple[float, float, float]
) -> Fit | None:
    """Fit turn scale, drift and the remaining skew; return None where there are too few intervals."""
    odometry = interpolate_odometry(motion, lag)
    parts = intervals(motion, odometry, reach)
    change = rates[parts.ends] - rates[parts.begins]
    parts = parts[np.isfinite(change)]
    change = change[np.isfinite(change)]
    if len(parts) < _FEWEST:
        return None
    turned = headings[parts.ends] - headings[parts.begins]
    way = np.copysign(np.hypot(parts.odometry[:, 0], parts.odometry[:, 1]), parts.odometry[:, 0])
    variance = parts.covariances[:, 2, 2] + _VARIANCES[0] * np.abs(way) + _VARIANCES[1] * np.abs(turned)
    sigma = np.sqrt(variance + np.square(_JITTER_S * change))
    design = np.stack([turned, way, change], axis=1) / sigma[:, None]
    reported = odometry[parts.ends, 2] - odometry[parts.begins, 2]
    return robust_fit(design[:, None, :], (reported / sigma)[:, None], _LEAST_SPREAD)
