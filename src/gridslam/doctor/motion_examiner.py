"""Checks that need scan matching: the motion of each laser against odometry, mounting and clock."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import final

import numpy as np

from gridslam.doctor.calibration import MotionCalibration, calibrate
from gridslam.doctor.finding import Figure, Finding, Mark, Series, Severity
from gridslam.doctor.intervals import turn_rates
from gridslam.doctor.laser_motion import LaserMotion, LaserMotionEstimator
from gridslam.doctor.motion_findings import motion_findings
from gridslam.io.measurement import Measurement
from gridslam.types import FloatArray, ScanGeometry

__all__ = ["MotionExaminer"]

_OF_WHEELS = {"odometry_scale", "odometry_rotation_bias", "odometry_drift", "wheel_slip"}
_SMEAR_RAD = 0.02  # over a scan: 10 cm at 5 m, two cells
_FASTEST = 0.998  # quantile of the turn rates: the greatest but for single wrong matches
_HALF, _HALF_SIGMAS = 0.25, 4.0  # of half the sweep, and deviations: how near to it a skew is that the sweep makes


@final
@dataclass(slots=True)
class _Laser:
    """One laser: its motion, and the duration of a scan, reported or assumed."""

    estimator: LaserMotionEstimator = field(default_factory=LaserMotionEstimator)
    geometry: ScanGeometry | None = None
    has_beam_times: bool = False
    sweep_s: float = math.nan

    def take(self, measurement: Measurement) -> None:
        scan = measurement.scan
        self.estimator.add(measurement)
        if len(scan) and (scan.geometry is not self.geometry or math.isnan(self.sweep_s)):
            self.geometry, times = scan.geometry, scan.beam_times_s
            self.has_beam_times = times is not None
            self.sweep_s = self.estimator.times.sweep_s(scan) if times is None else float(np.ptp(times))


@final
class MotionExaminer:
    """Finds skewed_while_turning, and the `motion_findings` of each laser."""

    def __init__(self) -> None:
        """Begin with no laser seen."""
        self._lasers: dict[str, _Laser] = {}

    def take(self, measurement: Measurement) -> None:
        """Match the next scan to those before it of the same laser."""
        sensor = measurement.scan.sensor
        laser = self._lasers.get(sensor)
        if laser is None:
            laser = self._lasers[sensor] = _Laser()
        laser.take(measurement)

    def findings(self) -> Iterator[Finding]:
        """Yield the findings of each laser; findings on the wheels once, if all lasers agree."""
        told = [findings for laser in self._lasers.values() if (findings := _findings_of(laser)) is not None]
        known: set[str] = set()
        for finding in (finding for findings in told for finding in findings):
            if finding.code in _OF_WHEELS:
                if finding.code in known or not all(finding.code in {f.code for f in each} for each in told):
                    continue  # a laser that leaves a bare corridor backward may see the robot stand still
                known.add(finding.code)
            yield finding


def _findings_of(laser: _Laser) -> list[Finding] | None:
    """Findings of one laser; None if its motion is not reliable."""
    motion = laser.estimator.motion
    if laser.geometry is None or len(motion) < 2:
        return None
    calibration = calibrate(motion)
    skewed = _skewed(motion, laser)
    found = [] if skewed is None else [skewed]
    for finding in motion_findings(motion, calibration):
        if not (skewed is not None and finding.code == "clock_skew" and _half_of_the_sweep(calibration, laser)):
            found.append(finding)
    return found if found or calibration.scale.determined else None


def _half_of_the_sweep(calibration: MotionCalibration, laser: _Laser) -> bool:
    """Whether scans look late or early because they are stamped by their last beam, or by their first."""
    skew, half_s = calibration.skew_s, 0.5 * laser.sweep_s
    return not laser.has_beam_times and abs(abs(skew.value) - half_s) < max(_HALF * half_s, _HALF_SIGMAS * skew.sigma)


def _skewed(motion: LaserMotion, laser: _Laser) -> Finding | None:
    """Find scans that are skewed by turning, and whether the log allows deskewing."""
    rates = np.abs(turn_rates(motion))
    fast = float(np.quantile(rates, _FASTEST))
    size, sweep_factor = fast * laser.sweep_s, laser.estimator.times.order.sweep_factor
    if not size >= _SMEAR_RAD or not (laser.has_beam_times or sweep_factor):
        return None
    about = "" if laser.has_beam_times else "about "
    message = f"A scan takes {about}{1e3 * laser.sweep_s:.0f} ms, in which the robot turns by up to {size:.2f} rad "
    message += f"({fast:.1f} rad/s)"
    if laser.has_beam_times:
        message += "; each beam has its time, and the scans are deskewed"
        wrong = ", but by their reverse, which fits better: the driver reports them in reverse order" * (
            sweep_factor < 0
        )
        return Finding("skewed_while_turning", Severity.INFO, f"{message}{wrong}.", size, "rad", "", motion.sensor)
    return Finding(
        "skewed_while_turning", Severity.WARNING,
        f"{message}, and the log has no beam times: walls are bent.", size, "rad",
        "Configure the driver to publish time_increment so that scans can be deskewed; until then turn more slowly.",
        motion.sensor, _figure(motion, rates, laser.sweep_s),
    )  # fmt: skip


def _figure(motion: LaserMotion, rates: FloatArray, sweep_s: float) -> Figure:
    times = (motion.stamps_ns - motion.stamps_ns[0]) * 1e-9
    smear = Series("turn during a scan", times, rates * sweep_s)
    return Figure("Turn during a scan", "time, s", "rad", (smear,), (Mark("harmful", _SMEAR_RAD),))
