"""Calibration from the turns of laser and odometry: scale, drift, and clock offset."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from gridslam.doctor.estimate import DETERMINED, FEWEST, LEAST_SPREAD, VARIANCES, ParameterEstimate, estimate_parameter
from gridslam.doctor.intervals import cumulative_headings, interpolate_odometry, intervals
from gridslam.doctor.laser_motion import LaserMotion
from gridslam.doctor.robust_fit import Fit, robust_fit
from gridslam.types import FloatArray

__all__ = ["Turns", "fit_turns"]

_BRIEF = (0.4, 0.25, 0.4)  # metres, radians, seconds of an interval: short beside the time a turn takes to begin
_TURNS = (1.5, 1.0, 2.0)  # long enough for odometry that comes late to catch up
_LAGS_S = np.arange(-1.0, 1.001, 0.05)
_UNEVEN = 0.6  # a pair of neighbours is farther apart than the usual by at most this share, or yields no turn rate
_BACKWARD = 0.01  # with a greater share of stamps that go backward, no skew can be estimated
_CONTRADICT = 3.5
"""Deviations by which the skew of brief intervals must differ from that of long ones to give way to it. It is the more
exact of the two, but where turns are few and begin in an instant the fit takes just those intervals for outliers."""
_JITTER_S = 0.005  # of stamps, and what interpolation between them costs


class Turns(NamedTuple):
    """Estimates from turns alone; the drift is per metre of odometry."""

    agreement: float
    turn_scale: ParameterEstimate
    drift: ParameterEstimate
    skew: ParameterEstimate


class _Lagged(NamedTuple):
    """Turns fitted at a lag, s, its standard deviation, and how far the last step moved it."""

    lag: float
    sigma: float
    step: float
    fit: Fit


def fit_turns(motion: LaserMotion) -> Turns:
    """Fit turns; the skew is first the lag at which they agree best, then that at which its linear term vanishes."""
    nothing = Turns(math.nan, ParameterEstimate(1.0), ParameterEstimate(0.0), ParameterEstimate(0.0))
    if len(motion) < FEWEST:
        return nothing
    jittering = float((np.diff(motion.stamps_ns) < 0).mean()) > _BACKWARD
    lag, agreement = _best_lag(motion, np.zeros(1) if jittering else _LAGS_S)
    if math.isnan(agreement):
        return nothing
    sign = math.copysign(1.0, agreement)
    headings = cumulative_headings(motion.poses) * sign
    rates = np.zeros(len(motion)) if jittering else _rates(motion) * sign
    brief = _fit_lags(motion, headings, rates, lag, _BRIEF)
    if brief is None:
        return nothing
    long = _fit_lags(motion, headings, rates, brief.lag, _TURNS)
    found = brief if long is None else _merge_lags(brief, long)
    sigma = math.inf if jittering else found.sigma
    skew = ParameterEstimate(found.lag, sigma, sigma < DETERMINED["skew"] and abs(found.step) < 0.01)
    fit = _fit_turns_at(motion, headings, rates, found.lag, _TURNS) or found.fit
    drift = estimate_parameter(fit, 1, DETERMINED["drift"])
    return Turns(agreement, estimate_parameter(fit, 0, DETERMINED["turn_scale"]), drift, skew)


def _merge_lags(brief: _Lagged, long: _Lagged) -> _Lagged:
    """Both, or where they contradict each other the long one; as they share their data, they err alike."""
    if abs(long.lag - brief.lag) > _CONTRADICT * math.hypot(long.sigma, brief.sigma):
        return long
    share = brief.sigma**2 / (brief.sigma**2 + long.sigma**2)
    mean = [(1 - share) * a + share * b for a, b in ((brief.lag, long.lag), (brief.sigma, long.sigma))]
    return _Lagged(mean[0], mean[1], brief.step, brief.fit)


def _fit_lags(
    motion: LaserMotion, headings: FloatArray, rates: FloatArray, lag: float, reach: tuple[float, float, float]
) -> _Lagged | None:
    """Fit turns at the lag at which their linear term vanishes, in three steps; None where there are too few."""
    step, fit = 0.0, _fit_turns_at(motion, headings, rates, lag, reach)
    for _ in range(3):
        if fit is None:
            return None
        step = float(np.clip(fit.parameters[2] / max(abs(fit.parameters[0]), 0.2), -0.1, 0.1))
        lag += step
        fit = _fit_turns_at(motion, headings, rates, lag, reach)
    return None if fit is None else _Lagged(lag, estimate_parameter(fit, 2, math.inf).sigma, step, fit)


def _best_lag(motion: LaserMotion, lags_s: FloatArray) -> tuple[float, float]:
    """The lag in s at which turns correlate best, and their correlation there; NaN where nothing turns."""
    best, agreement = 0.0, math.nan
    parts = intervals(motion, interpolate_odometry(motion, 0.0), _BRIEF)
    if len(parts) < FEWEST or np.abs(parts.laser[:, 2]).sum() < 1.0:
        return best, agreement
    for lag in sorted(lags_s.tolist(), key=abs):
        headings = interpolate_odometry(motion, lag)[:, 2]
        told = headings[parts.ends] - headings[parts.begins]
        known = np.isfinite(told)
        mine, told = parts.laser[known, 2], told[known]
        found = float(mine @ told / max(math.sqrt(float(mine @ mine) * float(told @ told)), 1e-9))
        if math.isnan(agreement) or abs(found) > abs(agreement) + 1e-3:
            best, agreement = lag, found
    return best, agreement


def _rates(motion: LaserMotion) -> FloatArray:
    """Turn rates (K,) of the laser, rad/s, by differences over about 0.3 s; NaN where stamps are uneven."""
    times = np.maximum.accumulate((motion.stamps_ns - motion.stamps_ns[0]) * 1e-9)
    headings = cumulative_headings(motion.poses)
    apart = max(1, round(0.15 / max(float(np.median(np.diff(times))), 1e-3)))
    rates = np.full(len(times), np.nan)
    passed = times[2 * apart :] - times[: -2 * apart]
    turned = headings[2 * apart :] - headings[: -2 * apart]
    even = np.abs(passed / max(float(np.median(passed)), 1e-9) - 1) < _UNEVEN if len(passed) else passed > 0
    rates[apart:-apart] = np.where(even, turned / np.maximum(passed, 1e-3), np.nan)
    return rates


def _fit_turns_at(
    motion: LaserMotion, headings: FloatArray, rates: FloatArray, lag: float, reach: tuple[float, float, float]
) -> Fit | None:
    """Turn scale, drift and what remains of the skew; None where there are too few intervals."""
    odometry = interpolate_odometry(motion, lag)
    parts = intervals(motion, odometry, reach)
    change = rates[parts.ends] - rates[parts.begins]
    parts, change = parts[np.isfinite(change)], change[np.isfinite(change)]
    if len(parts) < FEWEST:
        return None
    turned = headings[parts.ends] - headings[parts.begins]
    way = np.copysign(np.hypot(parts.odometry[:, 0], parts.odometry[:, 1]), parts.odometry[:, 0])
    variance = parts.covariances[:, 2, 2] + VARIANCES[0] * np.abs(way) + VARIANCES[1] * np.abs(turned)
    sigma = np.sqrt(variance + np.square(_JITTER_S * change))
    design = np.stack([turned, way, change], axis=1) / sigma[:, None]
    told = odometry[parts.ends, 2] - odometry[parts.begins, 2]
    return robust_fit(design[:, None, :], (told / sigma)[:, None], LEAST_SPREAD)
