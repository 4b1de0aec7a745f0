"""A log that is read as it should have been recorded: without the faults that make any map unusable."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Literal, final

import numpy as np

from gridslam.checked import checked
from gridslam.doctor.calibration import MotionCalibration, calibrate
from gridslam.doctor.laser_motion import LaserMotionEstimator
from gridslam.doctor.lasers import BeamStatistics
from gridslam.doctor.mirrored_odometry import Mirrored, unmirror_odometry
from gridslam.doctor.motion_findings import motion_findings
from gridslam.doctor.range_limits import RangeCounts
from gridslam.errors import ArgumentError
from gridslam.geometry.se2 import adjoint, between
from gridslam.io.log import Log, LogOptions, LogSource, open_if_path
from gridslam.io.log_statistics import LogStatistics
from gridslam.io.measurement import Measurement
from gridslam.types import BeamStatus, FloatArray, ScanGeometry

_EARLY_SCANS = 1000
_EARLY = (8.0, 6.0)  # m, rad
_EARLY_HZ = 7.0  # every other scan of 10 Hz is as informative
_NO_ODOMETRY_SCANS = 50
_SURELY_REFLECTED = -0.7
_TURNED_RAD = 1.2
_SPOILING_YAW_RAD = 0.35
_SIGMAS = 6.0
_GROSS = 0.2  # error of a scale that no wheels have
_CONTRADICTIONS = ("odometry_unrelated", "odometry_frozen", "odometry_units")
_OF_SCALES = ("odometry_scale", "odometry_rotation_bias")


@final
@dataclass(frozen=True, slots=True)
class Repair:
    """Corrections of a log; the defaults leave it unchanged.

    Attributes
    ----------
    reflected : bool
        The beam order is reversed relative to the log.
    yaw_rad : float, rad
        Error of the mounting yaw, to the left.
    range_max_m : float or None, m
        Hits from this range on are beams that hit nothing; None: there are none.
    mirrored : "", "heading" or "path"
        What of the odometry has the wrong sign: its headings, or y.
    """

    reflected: bool = False
    yaw_rad: float = 0.0
    range_max_m: float | None = None
    mirrored: Mirrored = ""

    def __bool__(self) -> bool:
        """Return whether there is anything to take out."""
        return self != Repair()

    def describe(self) -> Iterator[str]:
        """Describe the corrections in words."""
        if self.reflected:
            yield (
                "laser or odometry is mirrored, undecided which: the beam order is reversed (a clockwise "
                "or upside-down laser); if it is the odometry, the map is a mirror image"
            )
        if self.mirrored:
            what = "its headings have" if self.mirrored == "heading" else "its y has"
            yield f"odometry is mirrored, its path contradicts its headings: {what} the wrong sign"
        if self.yaw_rad:
            yield f"the mounting yaw of the laser is off by {math.degrees(self.yaw_rad):+.1f} degrees"
        if self.range_max_m is not None:
            yield f"no-return beams are reported as hits from {self.range_max_m:.2f} m on"


def find_needed_repair(calibration: MotionCalibration, range_max_m: float | None = None) -> Repair:
    """Find faults that make any map wrong: mirrored laser or odometry, or a mounting that is off by 20 degrees.

    Matching compensates for all other errors, but these it cannot detect: it relies on the odometry there. The yaw is
    corrected only where that brings laser and odometry together. Hits from `range_max_m` on that are none follow the
    robot around, and hold it back along a corridor.
    """
    if calibration.headings_in_degrees:  # then the turns have no sign
        return Repair(range_max_m=range_max_m)
    reflected = calibration.agreement < _SURELY_REFLECTED and calibration.laser_rad > _TURNED_RAD
    yaw = calibration.yaw_rad
    large = yaw.differs(0.0, _SPOILING_YAW_RAD, _SIGMAS) and calibration.yaw_improves
    yaw_rad = yaw.value if large else 0.0
    return Repair(bool(reflected), yaw_rad, range_max_m=range_max_m, mirrored=calibration.mirrored)


def describe_disagreement(calibration: MotionCalibration) -> str:
    """Describe in a sentence that laser and odometry cannot both be right; empty where nothing speaks against it."""
    gross = (
        finding.message.rstrip(".")
        for finding in motion_findings(calibration)
        if finding.code in _CONTRADICTIONS or (finding.code in _OF_SCALES and abs(finding.size or 0.0) > _GROSS)
    )
    return next(gross, "")


def calibrate_early(measurements: Iterable[Measurement]) -> MotionCalibration:
    """Calibrate with the beginning of a log: until 8 m and 6 rad of odometry, or 1000 scans of the first laser.

    That settles the faults of `find_needed_repair` in a fraction of a second; a log without odometry settles none.
    """
    estimator = LaserMotionEstimator(rate_hz=_EARLY_HZ)
    last: FloatArray | None = None
    moved = np.zeros(2)
    end = np.array(_EARLY)
    for measurement in _of_first_laser(measurements):
        estimator.add(measurement)
        if measurement.odometry is not None:
            pose = measurement.odometry.pose
            step = between(pose if last is None else last, pose)
            moved += [math.hypot(step[0], step[1]), abs(step[2])]
            last = pose
        enough = _NO_ODOMETRY_SCANS if last is None else _EARLY_SCANS
        if len(estimator) >= enough:
            break
        if (moved > end).all():
            found = calibrate(estimator.motion)
            if found.laser_rad > _TURNED_RAD:
                return found
            end *= 2  # the turns of the odometry are none
    return calibrate(estimator.motion)


def repair_measurements(
    measurements: Iterable[Measurement], repair: Repair, sensor: str | None = None
) -> Iterator[Measurement]:
    """Take the faults out of a stream: scans and their stamps are kept, their geometry and odometry are corrected.

    Parameters
    ----------
    measurements : iterable of Measurement
        Not read ahead.
    repair : Repair
        What to take out.
    sensor : str, optional
        The laser whose direction, yaw and range are corrected; that of the first scan if not given. Odometry is
        corrected for all.
    """

    @cache
    def turned(geometry: ScanGeometry) -> ScanGeometry:
        mounting = geometry.base_from_laser.copy()
        mounting[:2, :3] = adjoint([0.0, 0.0, repair.yaw_rad])[:2, :2] @ mounting[:2, :3]
        return ScanGeometry(-geometry.bearings if repair.reflected else geometry.bearings, mounting)

    for odometry, scan in measurements:
        sensor = scan.sensor if sensor is None else sensor
        if scan.sensor == sensor:
            if repair.reflected or repair.yaw_rad:
                scan = replace(scan, geometry=turned(scan.geometry))
            if repair.range_max_m is not None:
                false = (scan.status == BeamStatus.HIT) & (scan.ranges >= repair.range_max_m)
                scan = replace(scan, status=np.where(false, np.uint8(BeamStatus.NO_RETURN), scan.status))
        if odometry is not None and repair.mirrored:
            odometry = replace(odometry, pose=unmirror_odometry(odometry.pose, repair.mirrored))
        yield Measurement(odometry, scan)


@final
@checked
class RepairedLog:
    """A log from which the faults that make any map unusable are taken out (see `find_needed_repair`).

    Parameters
    ----------
    log : Log
        What is read. What is wrong with its first laser is found out before the first iteration, from a reading of its
        own.

    Attributes
    ----------
    repair : Repair or None
        What is taken out; None before the first iteration.
    disagreement : str
        How laser and odometry contradict each other beyond that; it is among the remarks of the statistics, too.
    """

    def __init__(self, log: Log) -> None:
        """Nothing is read before the iteration."""
        self._log = log
        self.repair: Repair | None = None
        self.disagreement = ""

    @property
    def path(self) -> Path:
        """The file or folder."""
        return self._log.path

    @property
    def statistics(self) -> LogStatistics:
        """Statistics of the latest iteration so far."""
        statistics = self._log.statistics
        if self.disagreement:
            statistics.remarks[f"{self.disagreement} (details: gridslam doctor)"] = 1
        return statistics

    def __iter__(self) -> Iterator[Measurement]:
        """Read the log from its start."""
        if self.repair is None:
            self.repair = self._find_repair()
        return repair_measurements(self._log, self.repair) if self.repair else iter(self._log)

    def _find_repair(self) -> Repair:
        counts = RangeCounts()
        beams = BeamStatistics()

        def counted() -> Iterator[Measurement]:
            for measurement in _of_first_laser(self._log):
                counts.take(measurement.scan)
                beams.take(measurement.scan)
                yield measurement

        found = calibrate_early(counted())
        self.disagreement = "" if beams.often_shows_one_thing else describe_disagreement(found)
        return find_needed_repair(found, counts.false_hits_m())


def _of_first_laser(measurements: Iterable[Measurement]) -> Iterator[Measurement]:
    sensor: str | None = None
    for measurement in measurements:
        sensor = measurement.scan.sensor if sensor is None else sensor
        if measurement.scan.sensor == sensor:
            yield measurement


def open_repaired(log: LogSource, options: LogOptions | None, kind: Literal["needed", "none"]) -> Log:
    """Open a log as `open_if_path` does, with the corrections of `RepairedLog`, or none.

    Raises ArgumentError for another `kind`, too.
    """
    if kind not in ("needed", "none"):
        raise ArgumentError("repair", "needed or none", kind)
    read = open_if_path(log, options)
    return read if kind == "none" else RepairedLog(read)
