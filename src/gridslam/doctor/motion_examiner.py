"""What only matching tells: the motion of each laser against odometry, mounting and clock."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import final

import numpy as np

from gridslam.doctor.beams import field_of_view_rad, is_clockwise
from gridslam.doctor.calibration import MotionCalibration, calibrate
from gridslam.doctor.finding import Figure, Finding, Mark, Series, Severity
from gridslam.doctor.laser_motion import LaserMotion, LaserWitness
from gridslam.doctor.motion_findings import motion_findings
from gridslam.doctor.sweep import measured_sweep, turn_rates
from gridslam.io.measurement import Measurement
from gridslam.types import FloatArray, ScanGeometry

__all__ = ["MotionExaminer"]

_OF_WHEELS = {"odometry_scale", "odometry_rotation_bias", "odometry_drift", "wheel_slip"}
_SMEAR_RAD = 0.02  # over a scan: 10 cm at 5 m, two cells
_FASTEST = 0.998  # quantile of the turn rates: the greatest but for single wrong matches
_LIKELY = 1.5, 3.0  # deviations by which left and right turns differ, where scans look early; late: no driver should
_HALF = 0.25  # of half the sweep: how near to it the scans must look late, or early, for the stamps to agree
_HIDDEN = 0.3  # share of the sweep that matching shows at least


@final
@dataclass(slots=True)
class _Laser:
    """One laser: what its motion tells, and how long it takes for a scan as told."""

    witness: LaserWitness = field(default_factory=LaserWitness)
    geometry: ScanGeometry | None = None
    told_s: float = math.nan

    def take(self, measurement: Measurement) -> None:
        scan = measurement.scan
        if scan.geometry is not self.geometry:
            self.geometry = scan.geometry
            times = scan.beam_times_s
            self.told_s = math.nan if times is None or len(times) == 0 else float(np.ptp(times))
        self.witness.add(measurement)


@final
class MotionExaminer:
    """Finds skewed_while_turning, and what `motion_findings` tells of each laser."""

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
        """Tell what the motion of each laser says; of the wheels, once, what all lasers see."""
        told = [findings for laser in self._lasers.values() if (findings := _told(laser)) is not None]
        known: set[str] = set()
        for finding in (finding for findings in told for finding in findings):
            if finding.code in _OF_WHEELS:
                if finding.code in known or not all(finding.code in {f.code for f in each} for each in told):
                    continue  # a laser that leaves a bare corridor backward may see the robot stand still
                known.add(finding.code)
            yield finding


def _told(laser: _Laser) -> list[Finding] | None:
    """What the motion of one laser says; None where it is no witness."""
    motion = laser.witness.motion
    if laser.geometry is None or len(motion) < 2:
        return None
    calibration = calibrate(motion)
    skewed = _skewed(motion, calibration, laser.geometry, laser.told_s)
    found = [] if skewed is None else [skewed]
    for finding in motion_findings(motion, calibration):
        if not (skewed is not None and skewed.is_fault and finding.code == "clock_skew"):
            found.append(finding)  # a sweep whose stamp is its first beam's looks late by half of it: told once
    return found if found or calibration.scale.determined else None


def _skewed(
    motion: LaserMotion, calibration: MotionCalibration, geometry: ScanGeometry, told_s: float
) -> Finding | None:
    """Tell where scans are smeared by turning, and whether the log lets that be undone."""
    rates = np.abs(turn_rates(motion))
    fast = float(np.quantile(rates, _FASTEST))
    if not math.isnan(told_s):
        if fast * told_s < _SMEAR_RAD:
            return None
        return Finding(
            "skewed_while_turning", Severity.INFO,
            f"A scan takes {1e3 * told_s:.0f} ms, in which the robot turns by up to {fast * told_s:.2f} rad "
            f"({fast:.1f} rad/s); each beam has its time, and the scans are straightened.",
            fast * told_s, "rad", "", motion.sensor,
        )  # fmt: skip
    seconds = np.diff(motion.stamps_ns) * 1e-9
    span = field_of_view_rad(geometry.bearings)
    sweep_s = float(np.median(seconds)) * span / math.tau
    if fast * sweep_s < _SMEAR_RAD:
        return None
    if not _sweeps(motion, calibration, geometry, sweep_s):
        return None
    return Finding(
        "skewed_while_turning", Severity.DOUBTFUL,
        f"A scan takes about {1e3 * sweep_s:.0f} ms, in which the robot turns by up to {fast * sweep_s:.2f} rad "
        f"({fast:.1f} rad/s), and the log does not tell when each beam was measured: walls come out bent.",
        fast * sweep_s, "rad",
        "Let the driver state time_increment, so that scans can be straightened; until then turn more slowly.",
        motion.sensor, _figure(motion, rates, sweep_s),
    )  # fmt: skip


def _sweeps(motion: LaserMotion, calibration: MotionCalibration, geometry: ScanGeometry, sweep_s: float) -> bool:
    """Whether turns show that the beams are measured one after the other, as by a mirror that turns once a scan.

    A scan stamped by its first beam, as messages define it, then looks half of the sweep early, by its last beam so
    much late, which the turns tell to some ms. Left and right turns alone tell too little: few of them lie far apart
    by chance.
    """
    span = field_of_view_rad(geometry.bearings)
    seen = measured_sweep(motion, span, reflected=calibration.reflected)
    seen_s = -seen.value if is_clockwise(geometry.bearings) else seen.value
    skew = calibration.skew_s
    agree = skew.determined and abs(abs(skew.value) - 0.5 * sweep_s) < _HALF * 0.5 * sweep_s
    return agree and seen.determined and seen_s > max(_LIKELY[skew.value > 0] * seen.sigma, _HIDDEN * sweep_s)


def _figure(motion: LaserMotion, rates: FloatArray, sweep_s: float) -> Figure:
    times = (motion.stamps_ns - motion.stamps_ns[0]) * 1e-9
    smear = Series("turn during a scan", times, rates * sweep_s)
    return Figure("Turn during a scan", "time, s", "rad", (smear,), (Mark("harmful", _SMEAR_RAD),))
