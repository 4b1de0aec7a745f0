"""A log that is read as it should have been recorded: laser, clock and odometry without their faults."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Literal, final

import numpy as np

from gridslam.checked import checked
from gridslam.doctor.calibration import MotionCalibration, ParameterEstimate, calibrate
from gridslam.doctor.laser_motion import LaserMotionEstimator, laser_motion
from gridslam.doctor.lasers import BeamStatistics
from gridslam.doctor.mirrored_odometry import Mirrored, unmirror_odometry
from gridslam.doctor.motion_findings import name_unit
from gridslam.doctor.range_limits import RangeCounts
from gridslam.errors import ArgumentError
from gridslam.geometry.se2 import adjoint, between, compose, exp, log
from gridslam.io.log import Log, LogOptions, LogSource, open_if_path
from gridslam.io.log_statistics import LogStatistics
from gridslam.io.measurement import Measurement
from gridslam.types import BeamStatus, FloatArray, Odometry, ScanGeometry

__all__ = [
    "Repair",
    "RepairedLog",
    "calibrate_early",
    "describe_disagreement",
    "find_full_repair",
    "find_needed_repair",
    "open_repaired",
    "repair_measurements",
]

_EARLY_SCANS = 1000
_EARLY = (8.0, 6.0)  # m, rad
_LOOKS = ((2.0, 1.6), (4.0, 3.2))  # m, rad: a log without faults is recognized sooner
_EARLY_HZ = 7.0  # every other scan of 10 Hz is as informative
_NO_ODOMETRY_SCANS = 50
_SURELY_REFLECTED = -0.7
_TURNED_RAD = 1.2
_SPOILING_YAW_RAD = 0.35
_SIGMAS = 6.0
_GROSS = 0.2  # error of a scale that no wheels have


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
    skew_s : float, s
        Scans are stamped so much too late.
    scale, turn_scale : float
        Measured metres per true metre, measured radians per true radian.
    drift_rad_per_m : float, rad/m
        What odometry turns too much to the left for each metre driven forward.
    range_max_m : float or None, m
        Hits from this range on are beams that hit nothing; None: there are none.
    mirrored : "", "heading" or "path"
        What of the odometry has the wrong sign: its headings, or y.
    """

    reflected: bool = False
    yaw_rad: float = 0.0
    skew_s: float = 0.0
    scale: float = 1.0
    turn_scale: float = 1.0
    drift_rad_per_m: float = 0.0
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
        if self.skew_s:
            late = "late" if self.skew_s > 0 else "early"
            yield f"scans are stamped {1e3 * abs(self.skew_s):.0f} ms too {late} against the odometry"
        if self.scale != 1:
            yield f"odometry scale is {self.scale:.3f} m per metre"
        if self.turn_scale != 1:
            yield f"odometry rotation scale is {self.turn_scale:.3f} rad per radian"
        if self.drift_rad_per_m:
            yield f"odometry heading drifts by {math.degrees(self.drift_rad_per_m):+.2f} degrees per metre"
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
    if not calibration.is_reliable:
        return ""
    if calibration.headings_in_degrees:
        return "the headings of the odometry look like degrees"
    if calibration.is_unrelated:
        return (
            f"odometry and laser both turn, but not at the same times (correlation {calibration.agreement:+.2f}): the "
            "angles of the scans are wrong, or the odometry is another robot's"
        )
    scale, turn_scale = calibration.scale, calibration.turn_scale
    if scale.differs(1.0, _GROSS):
        unit = name_unit(scale.value) or ": one of both is in another unit"
        return f"odometry moves {scale.value:.3g} times as far as the laser{unit}; the map is in the laser's"
    if turn_scale.differs(1.0, _GROSS):
        return f"odometry turns {turn_scale.value:.3g} times as far as the laser: its headings are wrong"
    return ""


def _is_clean(calibration: MotionCalibration) -> bool:
    """Return whether neither fault of `find_needed_repair` can be there."""
    yaw = calibration.yaw_rad
    upright = calibration.agreement > -_SURELY_REFLECTED and calibration.laser_rad > _TURNED_RAD
    return upright and yaw.determined and abs(yaw.value) + _SIGMAS * yaw.sigma < _SPOILING_YAW_RAD


def _may_be_gross(calibration: MotionCalibration) -> bool:
    """Return whether a scale is so far off that `describe_disagreement` would report it, were it determined."""
    return max(abs(estimate.value - 1) for estimate in (calibration.scale, calibration.turn_scale)) > _GROSS


def find_full_repair(calibration: MotionCalibration, range_max_m: float | None = None) -> Repair:
    """Return all faults that the calibration determines reliably: those larger than four standard deviations."""

    def sure(estimate: ParameterEstimate, usual: float) -> float:
        return estimate.value if estimate.differs(usual, 0.0) else usual

    return Repair(
        find_needed_repair(calibration).reflected,
        sure(calibration.yaw_rad, 0.0),
        sure(calibration.skew_s, 0.0),
        sure(calibration.scale, 1.0),
        sure(calibration.turn_scale, 1.0),
        sure(calibration.drift_rad_per_m, 0.0),
        range_max_m,
        calibration.mirrored,
    )


def calibrate_early(measurements: Iterable[Measurement]) -> MotionCalibration:
    """Calibrate with the beginning of a log: until 8 m and 6 rad of odometry, or 1000 scans of the first laser.

    That settles the two faults of `find_needed_repair` in a fraction of a second, and mostly after 2 m and 1.6 rad
    where neither is there; a log without odometry settles neither.
    """
    estimator = LaserMotionEstimator(rate_hz=_EARLY_HZ)
    last: FloatArray | None = None
    moved = np.zeros(2)
    looks = list(_LOOKS)
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
        if looks and (moved > looks[0]).all():
            looks.pop(0)
            found = calibrate(estimator.motion)
            if _is_clean(found) and not _may_be_gross(found):
                return found
    return calibrate(estimator.motion)


def repair_measurements(
    measurements: Iterable[Measurement], repair: Repair, sensor: str | None = None
) -> Iterator[Measurement]:
    """Take the faults out of a stream: scans and their stamps are kept, their geometry and odometry are corrected.

    Parameters
    ----------
    measurements : iterable of Measurement
        Read ahead by the skew where that is negative, else not at all.
    repair : Repair
        What to take out.
    sensor : str, optional
        The laser whose direction, yaw, skew and range are corrected; that of the first scan if not given. Odometry is
        corrected for all.

    Yields
    ------
    Measurement
        Odometry is that of the time at which the scan was taken; within one skew of the log's begin or end it is the
        first or last that is known.
    """

    @cache
    def turned(geometry: ScanGeometry) -> ScanGeometry:
        mounting = geometry.base_from_laser.copy()
        mounting[:2, :3] = adjoint([0.0, 0.0, repair.yaw_rad])[:2, :2] @ mounting[:2, :3]
        return ScanGeometry(-geometry.bearings if repair.reflected else geometry.bearings, mounting)

    reported: FloatArray | None = None
    pose = np.zeros(3)
    for odometry, scan in _remove_skew(measurements, repair.skew_s, sensor):
        sensor = scan.sensor if sensor is None else sensor
        if scan.sensor == sensor:
            if repair.reflected or repair.yaw_rad:
                scan = replace(scan, geometry=turned(scan.geometry))
            if repair.range_max_m is not None:
                false = (scan.status == BeamStatus.HIT) & (scan.ranges >= repair.range_max_m)
                scan = replace(scan, status=np.where(false, np.uint8(BeamStatus.NO_RETURN), scan.status))
        if odometry is not None:
            now = unmirror_odometry(odometry.pose, repair.mirrored) if repair.mirrored else odometry.pose
            pose = now if reported is None else compose(pose, _true_increment(reported, now, repair))
            reported = now
            odometry = replace(odometry, pose=pose)
        yield Measurement(odometry, scan)


def _true_increment(before: FloatArray, after: FloatArray, repair: Repair) -> FloatArray:
    """Return pose (3,) of `after` seen from `before`, without the errors of odometry."""
    x, y, turn = (log(between(before, after)) / [repair.scale, repair.scale, 1.0]).tolist()
    return exp([x, y, (turn - repair.drift_rad_per_m * math.copysign(math.hypot(x, y), x)) / repair.turn_scale])


def _remove_skew(measurements: Iterable[Measurement], skew_s: float, sensor: str | None) -> Iterator[Measurement]:
    """Give each scan of the laser the odometry of `skew_s` before its stamp."""
    skew_ns = round(skew_s * 1e9)
    if skew_ns == 0:
        yield from measurements
        return
    waiting: deque[Measurement] = deque()
    readings: deque[Odometry] = deque()
    for measurement in measurements:
        sensor = measurement.scan.sensor if sensor is None else sensor
        waiting.append(measurement)
        if measurement.odometry is not None:
            readings.append(measurement.odometry)
        while waiting and readings and readings[-1].stamp_ns >= waiting[0].scan.stamp_ns - skew_ns:
            yield _at(waiting.popleft(), readings, skew_ns, sensor)
    while waiting:
        yield _at(waiting.popleft(), readings, skew_ns, sensor)


def _at(measurement: Measurement, readings: deque[Odometry], skew_ns: int, sensor: str | None) -> Measurement:
    """Return the scan with the odometry of the time it was taken at; forgets readings that are not needed again."""
    odometry, scan = measurement
    if odometry is None or scan.sensor != sensor:
        return measurement
    taken = scan.stamp_ns - skew_ns
    while len(readings) > 2 and readings[1].stamp_ns <= taken:
        readings.popleft()
    before = readings[0]
    after = readings[min(1, len(readings) - 1)]
    passed = after.stamp_ns - before.stamp_ns
    share = min(max((taken - before.stamp_ns) / passed, 0.0), 1.0) if passed > 0 else 0.0
    pose = compose(before.pose, exp(share * log(between(before.pose, after.pose))))
    return Measurement(replace(odometry, pose=pose), scan)


@final
@checked
class RepairedLog:
    """A log from which the faults of the laser's mounting, of the clocks and of the odometry are taken out.

    Parameters
    ----------
    log : Log
        What is read. What is wrong with its first laser is found out before the first iteration, from a reading of its
        own.
    kind : "needed" or "all"
        Only faults that make any map unusable, estimated from the beginning of the log (see `find_needed_repair`), or
        all faults that are certain, estimated from the whole log (see `find_full_repair`).
    on_repair : callable
        Gets the repair, if there is any, before the first measurement.

    Attributes
    ----------
    repair : Repair or None
        What is taken out; None before the first iteration.
    disagreement : str
        How laser and odometry contradict each other beyond that; it is among the remarks of the statistics, too.
    """

    def __init__(
        self,
        log: Log,
        kind: Literal["needed", "all"] = "needed",
        on_repair: Callable[[Repair], None] = lambda repair: None,
    ) -> None:
        """Nothing is read before the iteration."""
        self._log = log
        self._kind = kind
        self._on_repair = on_repair
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
            if self.repair:
                self._on_repair(self.repair)
        return repair_measurements(self._log, self.repair) if self.repair else iter(self._log)

    def _find_repair(self) -> Repair:
        counts = RangeCounts()
        beams = BeamStatistics()

        def counted() -> Iterator[Measurement]:
            for measurement in _of_first_laser(self._log):
                counts.take(measurement.scan)
                beams.take(measurement.scan)
                yield measurement

        if self._kind == "all":
            found = calibrate(laser_motion(counted()))
            return find_full_repair(found, counts.false_hits_m())
        found = calibrate_early(counted())
        self.disagreement = "" if beams.often_shows_one_thing else describe_disagreement(found)
        return find_needed_repair(found, counts.false_hits_m())


def _of_first_laser(measurements: Iterable[Measurement]) -> Iterator[Measurement]:
    sensor: str | None = None
    for measurement in measurements:
        sensor = measurement.scan.sensor if sensor is None else sensor
        if measurement.scan.sensor == sensor:
            yield measurement


def open_repaired(log: LogSource, options: LogOptions | None, kind: Literal["needed", "all", "none"]) -> Log:
    """Open a log as `open_if_path` does, with the corrections of `RepairedLog`, or none.

    Raises ArgumentError for another `kind`, too.
    """
    if kind not in ("needed", "all", "none"):
        raise ArgumentError("repair", "needed, all or none", kind)
    read = open_if_path(log, options)
    return read if kind == "none" else RepairedLog(read, kind)
