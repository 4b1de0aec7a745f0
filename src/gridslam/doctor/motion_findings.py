"""Checks that need scan matching: the motion of each laser against odometry, mounting and clock."""

from __future__ import annotations

import math
from collections.abc import Iterator

from gridslam.doctor.calibration import MotionCalibration
from gridslam.doctor.finding import Finding, Severity
from gridslam.doctor.range_units import UNITS

# Differences from which on they are reported, and are more than information. Wheel odometry errs by a percent or
# two on every robot and matching compensates for it; larger errors can be measured and corrected.
_REPORTED_SCALE = 0.012
_SCALE = 0.02
_REPORTED_TURN_SCALE = 0.015
_TURN_SCALE = 0.025
_REPORTED_DRIFT = 0.006
_FROZEN = 0.01  # scale of odometry that hardly moves
_NO_TURN = 0.05  # turn scale of a heading that is not computed
_SAME_UNIT = 0.06  # of a scale: wheels err by some percent besides
_DRIFT = 0.01  # rad/m: half a degree a metre
_YAW = 0.06  # rad: 6 % of the way sideways
_YAW_SPOILS = 0.35  # rad: from 20 degrees on matching begins too far off
_SKEW = 0.014  # s: at 1 rad/s it moves what odometry alone would draw at 4 m by a cell
_SKEW_HARMS_S = 0.3
"""Matching corrects smaller errors: the maps of Intel, ACES and six simulated drives at about 1 rad/s had the same
errors with skews of up to 1 s, six drives at 3 rad/s with 0.1 s; with 0.3 s two of these six were lost."""
_SKEW_SIGMAS = 3.0
_OPPOSITE = -0.6  # correlation of the turns
_TURNED_RAD = 1.2  # one corner suffices


def motion_findings(found: MotionCalibration) -> list[Finding]:
    """Return the findings on mounting, clock and odometry, by the motion of one laser.

    A fault is reported only if it is larger than what every robot has, and than four standard deviations of its
    estimate. Codes: reflected_laser, odometry_mirrored, yaw_offset, clock_skew, odometry_scale,
    odometry_rotation_bias, odometry_drift, odometry_frozen, odometry_unrelated, odometry_units.
    """
    if not found.is_reliable:
        return []
    if found.headings_in_degrees:
        return [_in_degrees(found)]
    if found.is_unrelated:
        return [_unrelated(found)]
    return [*_laser_findings(found), *_odometry_findings(found)]


def _unrelated(found: MotionCalibration) -> Finding:
    return Finding(
        "odometry_unrelated",
        Severity.ERROR,
        f"Odometry turned by {found.odometry_rad:.1f} rad, the laser by {found.laser_rad:.1f} rad, but not at the same "
        f"times (correlation {found.agreement:+.2f}): it belongs to another robot or another time.",
        found.agreement,
        "1",
        "Choose the odometry's topic, or map with --no-odometry.",
        found.motion.sensor,
    )


def _in_degrees(found: MotionCalibration) -> Finding:
    return Finding(
        "odometry_units",
        Severity.WARNING,
        "The headings of the odometry look like degrees: read as rad they turn 57.3 times as far as the laser.",
        math.degrees(1.0),
        "rad/rad",
        "Convert the headings to rad where the odometry is computed; map with --no-odometry until then.",
        found.motion.sensor,
    )


def _laser_findings(found: MotionCalibration) -> Iterator[Finding]:
    """Yield direction, yaw and clock of the laser."""
    if found.mirrored:
        yield _mirrored(found)
    if found.agreement < _OPPOSITE and found.laser_rad >= _TURNED_RAD:
        cause = (
            "the log declares the laser upside-down, and its beams come in the order of an upright one"
            if found.motion.upside_down
            else "its beams run clockwise, or it is mounted upside-down, contrary to the log"
        )
        yield Finding(
            "reflected_laser",
            Severity.ERROR,
            "Laser or odometry is mirrored: the laser sees the robot turn the other way than odometry does "
            f"(correlation {found.agreement:+.2f} over {found.laser_rad:.0f} rad), whose path does not contradict its "
            f"headings. Mostly {cause}; or all of the odometry is mirrored, as by swapped wheels: no log decides "
            "that. The map would be a mirror image.",
            found.agreement,
            "1",
            "Drive a left bend. If the odometry's heading grows the laser is mirrored: reverse the signs of angle_min, "
            "angle_max and angle_increment, or mount it upside-down in /tf_static. If it falls left and right wheels "
            "are swapped; until that is repaired map with --no-odometry.",
            found.motion.sensor,
        )
    yaw = found.yaw_rad
    if yaw.differs(0.0, _YAW):
        degrees = math.degrees(yaw.value)
        declared = math.degrees(found.motion.mounting[2])
        yield Finding(
            "yaw_offset",
            Severity.ERROR if abs(yaw.value) > _YAW_SPOILS else Severity.WARNING,
            f"The laser is rotated by {abs(degrees):.1f} +- {math.degrees(yaw.sigma):.1f} degrees to the "
            f"{_side(degrees)} relative to the declared mounting ({declared:.1f} degrees).",
            yaw.value,
            "rad",
            f"Set the yaw of the laser's mounting to {declared + degrees:.1f} degrees.",
            found.motion.sensor,
        )
    skew = found.skew_s
    if skew.differs(0.0, _SKEW, _SKEW_SIGMAS):
        milliseconds = 1e3 * skew.value
        late = "late" if skew.value > 0 else "early"
        harms = abs(skew.value) > _SKEW_HARMS_S
        yield Finding(
            "clock_skew",
            Severity.WARNING if harms else Severity.INFO,
            f"Scans are {abs(milliseconds):.0f} +- {1e3 * skew.sigma:.0f} ms {late} against odometry: the measured "
            f"turns agree when the scans' stamps are moved by {-milliseconds:+.0f} ms, or those of the odometry by "
            f"{milliseconds:+.0f} ms; the log does not determine which of the two is wrong"
            f"{'' if harms else ', and matching compensates it'}.",
            skew.value,
            "s",
            "Stamp both when they are measured, by one clock." if harms else "",
            found.motion.sensor,
        )


def _mirrored(found: MotionCalibration) -> Finding:
    wrong, right, remedy = (
        ("headings have", "path", "Reverse the sign of the yaw where the odometry is computed")
        if found.mirrored == "heading"
        else ("path has", "headings", "Reverse the sign of y where the odometry is computed")
    )
    return Finding(
        "odometry_mirrored",
        Severity.ERROR,
        f"Odometry is mirrored: its path bends the other way than its headings turn, and the laser, which turned by "
        f"{found.laser_rad:.0f} rad, agrees with its {right}: its {wrong} the wrong sign.",
        1.0,
        "yes or no",
        f"{remedy}; mapping corrects it.",
        found.motion.sensor,
    )


def _odometry_findings(found: MotionCalibration) -> Iterator[Finding]:
    """Yield the errors of the odometry: it stands still, or errs systematically."""
    scale = found.scale
    if scale.determined and scale.value < _FROZEN:
        yield Finding(
            "odometry_frozen",
            Severity.ERROR,
            f"Odometry stands still while the laser moves by {found.laser_m:.0f} m: it is frozen.",
            found.laser_m,
            "m",
            "Look for what stops odometry on the robot; map with --no-odometry until then.",
            found.motion.sensor,
        )
        return
    if scale.differs(1.0, _REPORTED_SCALE):
        percent = 100 * (scale.value - 1)
        yield Finding(
            "odometry_scale",
            Severity.WARNING if scale.differs(1.0, _SCALE) else Severity.INFO,
            f"Odometry reports {abs(percent):.1f} +- {100 * scale.sigma:.1f} % {_more(percent)} distance than the "
            f"laser measures, over {found.laser_m:.0f} m{_name_unit(scale.value)}.",
            scale.value - 1,
            "m/m",
            f"Divide the odometry's distances (the wheels' diameter) by {scale.value:.3f}.",
            found.motion.sensor,
        )
    turn = found.turn_scale
    if turn.differs(1.0, _REPORTED_TURN_SCALE):
        percent = 100 * (turn.value - 1)
        yield Finding(
            "odometry_rotation_bias",
            Severity.WARNING if turn.differs(1.0, _TURN_SCALE) else Severity.INFO,
            f"Odometry turns {abs(percent):.1f} +- {100 * turn.sigma:.1f} % {_more(percent)} than the laser measures, "
            f"over {found.laser_rad:.0f} rad.",
            turn.value - 1,
            "rad/rad",
            f"Multiply the distance between the wheels by {turn.value:.3f}."
            if abs(turn.value) > _NO_TURN
            else "Compute the heading of the odometry: it stays the same while the robot turns.",
            found.motion.sensor,
        )
    drift = found.drift_rad_per_m
    if drift.differs(0.0, _REPORTED_DRIFT):
        degrees = math.degrees(drift.value)
        yield Finding(
            "odometry_drift",
            Severity.WARNING if drift.differs(0.0, _DRIFT) else Severity.INFO,
            f"Odometry turns {abs(degrees):.2f} +- {math.degrees(drift.sigma):.2f} degrees to the {_side(degrees)} a "
            f"metre driven, beyond what the laser saw over {found.laser_m:.0f} m.",
            drift.value,
            "rad/m",
            f"Make the {_side(-degrees)} wheel's diameter in the odometry smaller until it is gone.",
            found.motion.sensor,
        )


def _name_unit(scale: float) -> str:
    """Name the unit of odometry or ranges that explains a scale, as the end of a sentence; empty where none does."""
    for name, of_a_metre in UNITS.items():
        for what, factor in (("it is", scale / of_a_metre), ("the ranges are", scale * of_a_metre)):
            if abs(factor - 1) < _SAME_UNIT:
                return f": {what} in {name}"
    return ""


def _more(amount: float) -> str:
    return "more" if amount > 0 else "less"


def _side(angle: float) -> str:
    return "left" if angle > 0 else "right"
