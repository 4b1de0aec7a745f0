"""A log with its faults taken out: the laser's direction and yaw, the clock's skew, the errors of odometry."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from gridslam.doctor.calibration import Estimate, MotionCalibration, calibrate
from gridslam.doctor.laser_motion import LaserWitness
from gridslam.geometry.se2 import between, compose, exp, log
from gridslam.io.measurement import Measurement
from gridslam.types import BeamStatus, FloatArray, LaserScan, Odometry, ScanGeometry

__all__ = ["Repair", "early_calibration", "full_repair", "needed_repair", "repaired"]

_EARLY_SCANS, _EARLY_M, _EARLY_RAD = 1000, 8.0, 6.0
_LOOKS = ((2.0, 1.6), (4.0, 3.2))  # m, rad: a log in which nothing is wrong is known as such sooner
_EARLY_HZ = 7.0  # every other scan of 10 Hz tells as much
_NO_ODOMETRY_SCANS = 50
_SURELY_REFLECTED, _TURNED_RAD = -0.7, 1.2
_SPOILING_YAW_RAD, _SIGMAS = 0.35, 6.0


@final
@dataclass(frozen=True, slots=True)
class Repair:
    """What is to be taken out of a log; the defaults leave it as it is.

    Attributes
    ----------
    reflected : bool
        The beams run the other way than the log says.
    yaw_rad : float, rad
        The laser looks so much farther to the left than the log says.
    skew_s : float, s
        Scans are stamped so much too late.
    scale, turn_scale : float
        Metres, radians that odometry tells for one.
    drift_rad_per_m : float, rad/m
        What odometry turns too much to the left for each metre driven forward.
    range_max_m : float or None, m
        Hits from this range on are beams that hit nothing; None: there are none.
    """

    reflected: bool = False
    yaw_rad: float = 0.0
    skew_s: float = 0.0
    scale: float = 1.0
    turn_scale: float = 1.0
    drift_rad_per_m: float = 0.0
    range_max_m: float | None = None

    def __bool__(self) -> bool:
        """Whether there is anything to take out."""
        return self != Repair()

    def says(self) -> Iterator[str]:
        """What is taken out, in words."""
        if self.reflected:
            yield "the beams run the other way than the log says (a laser that turns clockwise, or is upside down)"
        if self.yaw_rad:
            yield f"the laser looks {math.degrees(self.yaw_rad):+.1f} degrees past where the log says"
        if self.skew_s:
            late = "late" if self.skew_s > 0 else "early"
            yield f"scans are stamped {1e3 * abs(self.skew_s):.0f} ms too {late} against the odometry"
        if self.scale != 1:
            yield f"odometry tells {self.scale:.3f} m for a metre"
        if self.turn_scale != 1:
            yield f"odometry tells {self.turn_scale:.3f} rad for a radian"
        if self.drift_rad_per_m:
            yield f"odometry turns {math.degrees(self.drift_rad_per_m):+.2f} degrees for each metre"
        if self.range_max_m is not None:
            yield f"beams that hit nothing are told as hits, from {self.range_max_m:.2f} m on"


def needed_repair(calibration: MotionCalibration, range_max_m: float | None = None) -> Repair:
    """What would make any map wrong: a reflected laser, or one that looks 20 degrees and more past where it should.

    Matching makes up for all else, while these two it cannot see: the odometry's motion is the only witness. Hits from
    `range_max_m` on that are none follow the robot around, and hold it back along a corridor.
    """
    reflected = calibration.agreement < _SURELY_REFLECTED and calibration.laser_rad > _TURNED_RAD
    yaw = calibration.yaw_rad
    large = yaw.differs(0.0, _SPOILING_YAW_RAD, _SIGMAS)
    return Repair(bool(reflected), yaw.value if large else 0.0, range_max_m=range_max_m)


def _is_clean(calibration: MotionCalibration) -> bool:
    """Whether neither fault of `needed_repair` can be there."""
    yaw = calibration.yaw_rad
    upright = calibration.agreement > -_SURELY_REFLECTED and calibration.laser_rad > _TURNED_RAD
    return upright and yaw.determined and abs(yaw.value) + _SIGMAS * yaw.sigma < _SPOILING_YAW_RAD


def full_repair(calibration: MotionCalibration, range_max_m: float | None = None) -> Repair:
    """All that the calibration tells for certain: what differs by more than four standard deviations."""

    def sure(estimate: Estimate, usual: float) -> float:
        return estimate.value if estimate.differs(usual, 0.0) else usual

    return Repair(
        needed_repair(calibration).reflected, sure(calibration.yaw_rad, 0.0), sure(calibration.skew_s, 0.0),
        sure(calibration.scale, 1.0), sure(calibration.turn_scale, 1.0), sure(calibration.drift_rad_per_m, 0.0),
        range_max_m,
    )  # fmt: skip


def early_calibration(measurements: Iterable[Measurement]) -> MotionCalibration:
    """Calibrate with the begin of a log: until odometry tells 8 m and 6 rad, or 1000 scans of the first laser.

    That settles the two faults of `needed_repair` in a fraction of a second, and mostly after 2 m and 1.6 rad where
    neither is there; a log without odometry settles neither.
    """
    witness, sensor, last = LaserWitness(rate_hz=_EARLY_HZ), None, None
    moved, looks = np.zeros(2), list(_LOOKS)
    for measurement in measurements:
        odometry, scan = measurement
        sensor = scan.sensor if sensor is None else sensor
        if scan.sensor != sensor:
            continue
        witness.add(measurement)
        if odometry is not None:
            step = between(odometry.pose if last is None else last, odometry.pose)
            moved += [math.hypot(step[0], step[1]), abs(step[2])]
            last = odometry.pose
        if last is None and len(witness) >= _NO_ODOMETRY_SCANS:
            break
        if len(witness) >= _EARLY_SCANS or (moved > [_EARLY_M, _EARLY_RAD]).all():
            break
        if looks and (moved > looks[0]).all():
            looks.pop(0)
            found = calibrate(witness.motion)
            if _is_clean(found):
                return found
    return calibrate(witness.motion)


def repaired(measurements: Iterable[Measurement], repair: Repair, sensor: str | None = None) -> Iterator[Measurement]:
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
    geometries: dict[ScanGeometry, ScanGeometry] = {}
    corrected = _Odometer(repair)
    for odometry, scan in _unskewed(measurements, repair.skew_s, sensor):
        sensor = scan.sensor if sensor is None else sensor
        seen = _limited(_turned(scan, repair, geometries), repair.range_max_m) if scan.sensor == sensor else scan
        yield Measurement(None if odometry is None else corrected(odometry), seen)


def _turned(scan: LaserScan, repair: Repair, geometries: dict[ScanGeometry, ScanGeometry]) -> LaserScan:
    if not (repair.reflected or repair.yaw_rad):
        return scan
    geometry = geometries.get(scan.geometry)
    if geometry is None:
        c, s = math.cos(repair.yaw_rad), math.sin(repair.yaw_rad)
        mounting = scan.geometry.base_from_laser.copy()
        mounting[:2, :3] = np.array([[c, -s], [s, c]]) @ mounting[:2, :3]
        bearings = -scan.geometry.bearings if repair.reflected else scan.geometry.bearings
        geometry = geometries[scan.geometry] = ScanGeometry(bearings, mounting)
    return replace(scan, geometry=geometry)


def _limited(scan: LaserScan, range_max_m: float | None) -> LaserScan:
    if range_max_m is None:
        return scan
    false = (scan.status == BeamStatus.HIT) & (scan.ranges >= range_max_m)
    if not false.any():
        return scan
    return replace(scan, status=np.where(false, np.uint8(BeamStatus.NO_RETURN), scan.status))


@final
class _Odometer:
    """Puts odometry together anew from corrected increments."""

    def __init__(self, repair: Repair) -> None:
        self._repair = repair
        self._told: FloatArray | None = None
        self._pose = np.zeros(3)

    def __call__(self, odometry: Odometry) -> Odometry:
        repair = self._repair
        if self._told is None:
            self._pose = odometry.pose
        else:
            x, y, turn = (log(between(self._told, odometry.pose)) / [repair.scale, repair.scale, 1.0]).tolist()
            turn = (turn - repair.drift_rad_per_m * math.copysign(math.hypot(x, y), x)) / repair.turn_scale
            self._pose = compose(self._pose, exp([x, y, turn]))
        self._told = odometry.pose
        return Odometry(odometry.stamp_ns, self._pose, odometry.covariance)


def _unskewed(
    measurements: Iterable[Measurement], skew_s: float, sensor: str | None
) -> Iterator[Measurement]:
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
    """The scan with the odometry of the time it was taken at; forgets readings that are not needed again."""
    odometry, scan = measurement
    if odometry is None or scan.sensor != sensor:
        return measurement
    taken = scan.stamp_ns - skew_ns
    while len(readings) > 2 and readings[1].stamp_ns <= taken:
        readings.popleft()
    before, after = readings[0], readings[min(1, len(readings) - 1)]
    passed = after.stamp_ns - before.stamp_ns
    share = min(max((taken - before.stamp_ns) / passed, 0.0), 1.0) if passed > 0 else 0.0
    pose = compose(before.pose, exp(share * log(between(before.pose, after.pose))))
    return Measurement(Odometry(odometry.stamp_ns, pose, odometry.covariance), scan)
