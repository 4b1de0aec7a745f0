"""Findings from the motion of a laser."""

from __future__ import annotations

import math

import numpy as np

from gridslam.doctor.calibration import MotionCalibration, ParameterEstimate, calibrate
from gridslam.doctor.finding import Figure, Finding, Mark, Series, Severity
from gridslam.doctor.intervals import turn_rates
from gridslam.doctor.laser_motion import LaserMotion
from gridslam.doctor.wheel_slip import Slip, wheel_slips
from gridslam.geometry.se2 import between
from gridslam.types import FloatArray

__all__ = ["motion_findings"]

# Differences from which on they are reported, and are more than information. Wheel odometry errs by a percent or
# two on every robot and matching compensates for it; larger errors can be measured and corrected.
_SCALE, _SCALE_TOLD = 0.02, 0.012
_TURN_SCALE, _TURN_SCALE_TOLD = 0.025, 0.015
_DRIFT, _DRIFT_TOLD = 0.01, 0.006  # rad/m: half a degree a metre
_YAW, _YAW_SPOILS = 0.06, 0.35  # rad: 6 % of the way sideways; from 20 degrees on matching begins too far off
_SKEW = 0.014  # s: at 1 rad/s it moves what odometry alone would draw at 4 m by a cell
_SKEW_HARMS_S, _SKEW_HARMS_RAD = 0.3, 0.5
"""Matching makes up for what is less: the maps of Intel, ACES and six simulated drives at about 1 rad/s had the same
errors with skews of up to 1 s, six drives at 3 rad/s with 0.1 s; with 0.3 s two of these six were lost."""
_FASTEST = 0.998  # quantile of the turn rates: the greatest but for single wrong matches
_SKEW_SIGMAS = 3.0
_OPPOSITE, _UNRELATED, _TURNED_RAD = -0.6, 0.5, 1.2  # one corner suffices
_SLIP_M, _SLIP_RAD, _SLIP_SHARE = 0.22, 0.3, 0.01  # of one episode; of all the way
_CONFUSED = 0.02  # tracks lost per scan, from which on the laser is no reference


def motion_findings(motion: LaserMotion, calibration: MotionCalibration | None = None) -> list[Finding]:
    """Yield the findings on mounting, clock and odometry, by the motion of one laser.

    A fault is reported only if it is larger than what every robot has, and than four standard deviations of its
    estimate.
    Reads `calibration` where that of `motion` is known already. Codes: reflected_laser, yaw_offset, clock_skew,
    odometry_scale, odometry_rotation_bias, odometry_drift, wheel_slip, odometry_unrelated.
    """
    if len(motion) < 2 or motion.tracks[-1] + 1 > max(3, _CONFUSED * len(motion)):
        return []
    found = calibration or calibrate(motion)
    if unrelated := _unrelated(motion, found):
        return [unrelated]
    told = [
        _reflected(motion, found), _yaw(motion, found), _skew(motion, found), _scale(motion, found),
        _rotation_bias(motion, found), _drift(motion, found), _slip(motion, found),
    ]  # fmt: skip
    return [finding for finding in told if finding is not None]


def _unrelated(motion: LaserMotion, found: MotionCalibration) -> Finding | None:
    if not abs(found.agreement) < _UNRELATED or min(found.laser_rad, found.odometry_rad) < _TURNED_RAD:
        return None
    return Finding(
        "odometry_unrelated", Severity.ERROR,
        f"Odometry turned by {found.odometry_rad:.1f} rad, the laser by {found.laser_rad:.1f} rad, but not at the same "
        f"times (correlation {found.agreement:+.2f}): it belongs to another robot or another time.",
        found.agreement, "1", "Choose the odometry's topic, or map with --no-odometry.", motion.sensor,
        _turns_figure(motion, 1.0),
    )  # fmt: skip


def _reflected(motion: LaserMotion, found: MotionCalibration) -> Finding | None:
    if not found.agreement < _OPPOSITE or found.laser_rad < _TURNED_RAD:
        return None
    cause = (
        "the log declares the laser upside-down, and its beams come in the order of an upright one"
        if motion.upside_down else "its beams run clockwise, or it is mounted upside-down, contrary to the log"
    )  # fmt: skip
    return Finding(
        "reflected_laser", Severity.ERROR,
        f"The laser sees the robot turn the other way than odometry does (correlation {found.agreement:+.2f} over "
        f"{found.laser_rad:.0f} rad): {cause}; the map would be a mirror image.",
        found.agreement, "1",
        "Reverse the signs of angle_min, angle_max and angle_increment, or mount it upside-down in /tf_static.",
        motion.sensor, _turns_figure(motion, 1.0),
    )  # fmt: skip


def _yaw(motion: LaserMotion, found: MotionCalibration) -> Finding | None:
    yaw = found.yaw_rad
    if not yaw.differs(0.0, _YAW):
        return None
    degrees, declared = math.degrees(yaw.value), math.degrees(found.mounting[2])
    return Finding(
        "yaw_offset", Severity.ERROR if abs(yaw.value) > _YAW_SPOILS else Severity.WARNING,
        f"The laser is rotated by {abs(degrees):.1f} +- {math.degrees(yaw.sigma):.1f} degrees to the "
        f"{_side(degrees)} relative to the declared mounting ({declared:.1f} degrees).",
        yaw.value, "rad", f"Set the yaw of the laser's mounting to {declared + degrees:.1f} degrees.", motion.sensor,
    )  # fmt: skip


def _skew(motion: LaserMotion, found: MotionCalibration) -> Finding | None:
    skew = found.skew_s
    if not skew.differs(0.0, _SKEW, _SKEW_SIGMAS):
        return None
    milliseconds, late = 1e3 * skew.value, "late" if skew.value > 0 else "early"
    wrong_rad = abs(skew.value) * float(np.quantile(np.abs(turn_rates(motion)), _FASTEST))
    harms = abs(skew.value) > _SKEW_HARMS_S or wrong_rad > _SKEW_HARMS_RAD
    return Finding(
        "clock_skew", Severity.WARNING if harms else Severity.INFO,
        f"Scans are {abs(milliseconds):.0f} +- {1e3 * skew.sigma:.0f} ms {late} against odometry: the measured turns "
        f"agree when the scans' stamps are moved by {-milliseconds:+.0f} ms, or those of the odometry by "
        f"{milliseconds:+.0f} ms; the log does not determine which of the two is wrong. In turns the odometry errs by "
        f"up to {wrong_rad:.2f} rad{'' if harms else ', which matching compensates'}.",
        skew.value, "s",
        "Stamp both when they are measured, by one clock; --repair all takes it out before mapping." if harms else "",
        motion.sensor, _turns_figure(motion, -1.0 if found.reflected else 1.0),
    )  # fmt: skip


def _grade(estimate: ParameterEstimate, usual: float, told: float, doubtful: float) -> Severity | None:
    if estimate.differs(usual, doubtful):
        return Severity.WARNING
    return Severity.INFO if estimate.differs(usual, told) else None


def _scale(motion: LaserMotion, found: MotionCalibration) -> Finding | None:
    severity = _grade(found.scale, 1.0, _SCALE_TOLD, _SCALE)
    if severity is None:
        return None
    percent, sigma = 100 * (found.scale.value - 1), 100 * found.scale.sigma
    return Finding(
        "odometry_scale", severity,
        f"Odometry reports {abs(percent):.1f} +- {sigma:.1f} % {_more(percent)} distance than the laser measures, over "
        f"{found.laser_m:.0f} m.",
        found.scale.value - 1, "m/m",
        f"Divide the odometry's distances (the wheels' diameter) by {found.scale.value:.3f}.", motion.sensor,
    )  # fmt: skip


def _rotation_bias(motion: LaserMotion, found: MotionCalibration) -> Finding | None:
    severity = _grade(found.turn_scale, 1.0, _TURN_SCALE_TOLD, _TURN_SCALE)
    if severity is None:
        return None
    percent, sigma = 100 * (found.turn_scale.value - 1), 100 * found.turn_scale.sigma
    return Finding(
        "odometry_rotation_bias", severity,
        f"Odometry turns {abs(percent):.1f} +- {sigma:.1f} % {_more(percent)} than the laser measures, over "
        f"{found.laser_rad:.0f} rad.",
        found.turn_scale.value - 1, "rad/rad",
        f"Multiply the distance between the wheels by {found.turn_scale.value:.3f}.", motion.sensor,
    )  # fmt: skip


def _drift(motion: LaserMotion, found: MotionCalibration) -> Finding | None:
    severity = _grade(found.drift_rad_per_m, 0.0, _DRIFT_TOLD, _DRIFT)
    if severity is None:
        return None
    degrees, sigma = math.degrees(found.drift_rad_per_m.value), math.degrees(found.drift_rad_per_m.sigma)
    return Finding(
        "odometry_drift", severity,
        f"Odometry turns {abs(degrees):.2f} +- {sigma:.2f} degrees to the {_side(degrees)} a metre driven, beyond "
        f"what the laser saw over {found.laser_m:.0f} m.",
        found.drift_rad_per_m.value, "rad/m",
        f"Make the {_side(-degrees)} wheel's diameter in the odometry smaller until it is gone.",
        motion.sensor,
    )  # fmt: skip


def _slip(motion: LaserMotion, found: MotionCalibration) -> Finding | None:
    slips = wheel_slips(motion, found)
    if not slips:
        return None
    sizes = np.array([abs(slip.metres) for slip in slips])
    turns = np.array([abs(slip.radians) for slip in slips])
    matters = sizes.max() > _SLIP_M or turns.max() > _SLIP_RAD or sizes.sum() > _SLIP_SHARE * found.laser_m
    largest = slips[int((sizes / _SLIP_M + turns / _SLIP_RAD).argmax())]
    seconds = (largest.stamp_ns - int(motion.stamps_ns[0])) * 1e-9
    return Finding(
        "wheel_slip", Severity.WARNING if matters else Severity.INFO,
        f"The wheels slipped {_times(len(slips))}, {sizes.sum():.2f} m and {turns.sum():.2f} rad in all; most after "
        f"{seconds:.0f} s: {largest.metres:.2f} m and {largest.radians:.2f} rad in {largest.duration_s:.1f} s.",
        *_size(sizes, turns), "Drive more gently there; scan matching compensates where walls constrain the motion.",
        motion.sensor, _slip_figure(motion, found, slips),
    )  # fmt: skip


def _more(amount: float) -> str:
    return "more" if amount > 0 else "less"


def _side(angle: float) -> str:
    return "left" if angle > 0 else "right"


def _times(count: int) -> str:
    return "once" if count == 1 else f"{count} times"


def _size(sizes: FloatArray, turns: FloatArray) -> tuple[float, str]:
    """Median of the episodes of way, or of turns where there are none."""
    ways = sizes > _SLIP_M / 2
    return (float(np.median(sizes[ways])), "m") if ways.any() else (float(np.median(turns)), "rad")


def _turns_figure(motion: LaserMotion, sign: float) -> Figure:
    """Turn rates of both over the part of the log in which the robot turns most."""
    times = (motion.stamps_ns - motion.stamps_ns[0]) * 1e-9
    steps = np.maximum(np.diff(times), 1e-3)
    laser = sign * between(motion.poses[:-1], motion.poses[1:])[:, 2] / steps
    odometry = np.nan_to_num(between(motion.odometry[:-1], motion.odometry[1:])[:, 2]) / steps
    width = min(len(laser), 150)
    turned = np.convolve(np.abs(laser) * steps, np.ones(width), "valid")
    part = slice(int(turned.argmax()), int(turned.argmax()) + width)
    series = (Series("laser", times[1:][part], laser[part]), Series("odometry", times[1:][part], odometry[part]))
    return Figure("Turn rate of laser and odometry", "time, s", "rad/s", series)


def _slip_figure(motion: LaserMotion, found: MotionCalibration, slips: list[Slip]) -> Figure:
    first = int(motion.stamps_ns[0])
    times: FloatArray = np.asarray(motion.stamps_ns[found.intervals.begins] - first, np.float64) * 1e-9
    marks = tuple(Mark("slip", (slip.stamp_ns - first) * 1e-9, "x") for slip in slips[:20])
    course = Series("odometry beyond the laser's motion", times, found.residuals[:, 0], "bars")
    return Figure("Wheel slip", "time, s", "m", (course,), marks)
