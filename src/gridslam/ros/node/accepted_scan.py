"""Conversion of scan messages to measurements, and their record: a CSV that is read back exactly as it was written.

`gridslam map` maps the record with identical results.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache
from itertools import count
from pathlib import Path
from typing import IO, NamedTuple, final

import numpy as np

from gridslam.errors import OutputError
from gridslam.geometry.angles import find_wrong_beam_angles
from gridslam.io.bags.ros_messages import ScanMessage
from gridslam.io.csv import COLUMNS, angles_of_rotation, quote_name, rotation_of_angles
from gridslam.io.measurement import Measurement
from gridslam.io.tables import format_stamp_ns
from gridslam.types import BeamStatus, FloatArray, LaserScan, Odometry, ScanGeometry

_MAX_GEOMETRIES = 64  # cheap lidars rotate unevenly, so each scan has its own angles
_NO_HIT = np.array([0.0, np.inf, np.nan])  # by status, of beams that hit nothing
_MOUNTING_NOISE_M = 0.005  # and rad: noise of a mounting on /tf


class AcceptedScan(NamedTuple):
    """A measurement for the filter, with its laser's values for the record.

    Attributes
    ----------
    measurement : Measurement
        The measurement.
    mounting : tuple of 6 float
        x, y, z in m, roll, pitch and yaw in rad, of the laser in the base frame.
    angle_min, angle_increment : float, rad
        Of the beams.
    time_increment_s : float or None
        Between beams, if known.
    arrived_s : float, s
        Arrival time of the message, of `time.perf_counter`.
    """

    measurement: Measurement
    mounting: tuple[float, ...]
    angle_min: float
    angle_increment: float
    time_increment_s: float | None
    arrived_s: float


def find_refusal_reason(message: ScanMessage, min_beams: int, max_beams: int) -> str:
    """Reason why a message is not a scan to map; empty for a scan of `min_beams` to `max_beams` beams."""
    beams = len(message.ranges)
    if beams > max_beams:
        return f"{beams} beams, more than the maximum of {max_beams}"
    if beams < min_beams:
        return f"{beams} beams are too few to localize; at least {min_beams} are required"
    if not message.frame or not message.frame.isprintable() or message.frame != message.frame.strip():
        return f"expected the name of a frame, got {message.frame!r:.60}"
    if not isinstance(message.stamp_ns, int) or not 0 < message.stamp_ns < 1 << 63:
        return f"expected a stamp of more than 0 s, got {message.stamp_ns} ns"
    if message.range_min == math.inf:
        return "range_min is infinite, so no range is valid"
    return find_wrong_beam_angles(message.angle_min, message.angle_increment, beams, message.angle_max)


@final
class MeasurementBuilder:
    """Builds measurements of one laser; scans of the same angles and mounting share their geometry.

    The mounting is rounded through its six numbers, and beams without a hit become `inf` or `nan`, as in the record.
    """

    def __init__(self) -> None:
        self._matrix: FloatArray = np.full((4, 4), np.nan)
        self._mounting: tuple[float, ...] = ()

    def build(
        self,
        message: ScanMessage,
        sensor: str,
        base_from_laser: FloatArray,
        odometry: Odometry | None,
        arrived_s: float,
    ) -> AcceptedScan:
        """Build the measurement of a message that `find_refusal_reason` accepts."""
        mounting = self._stabilize_mounting(base_from_laser)
        start = float(message.angle_min) + 0.0  # no -0.0, which the cache of geometries takes for 0.0
        step = float(message.angle_increment)
        time_increment = float(message.time_increment)
        scan = LaserScan.from_ros(
            message.stamp_ns,
            message.ranges,
            angle_min=start,
            angle_increment=step,
            range_min=message.range_min,
            range_max=message.range_max,
            time_increment=time_increment,
            sensor=sensor,
            frame=message.frame,
            geometry=_make_geometry(mounting, start, step, len(message.ranges)),
        )
        ranges: FloatArray = np.where(scan.status == BeamStatus.HIT, scan.ranges, _NO_HIT[scan.status])
        ranges.flags.writeable = False
        measurement = Measurement(odometry, replace(scan, ranges=ranges))
        known_increment = None if scan.beam_times_s is None else time_increment
        return AcceptedScan(measurement, mounting, start, step, known_increment, arrived_s)

    def _stabilize_mounting(self, matrix: FloatArray) -> tuple[float, ...]:
        if not np.abs(matrix - self._matrix).max() <= _MOUNTING_NOISE_M:
            self._matrix = matrix
            values = *matrix[:3, 3].tolist(), *angles_of_rotation(matrix[:3, :3])
            self._mounting = tuple(value + 0.0 for value in values)  # no -0.0
        return self._mounting


@lru_cache(_MAX_GEOMETRIES)
def _make_geometry(mounting: tuple[float, ...], start: float, step: float, beams: int) -> ScanGeometry:
    matrix = np.eye(4)
    matrix[:3, :3] = rotation_of_angles(*mounting[3:])
    matrix[:3, 3] = mounting[:3]
    return ScanGeometry(start + step * np.arange(beams), matrix)


@final
class ScanRecorder:
    """Writes each accepted scan as one row in one write, so that a killed node loses none of them.

    If a row cannot be written because the disk is full, the record ends with the previous row.

    Parameters
    ----------
    path : str or Path
        The file. An earlier record is never written to: where there is one, `-2`, `-3`, ... is added before the suffix.

    Attributes
    ----------
    path : Path
        The file that is written.

    Raises
    ------
    OutputError
        The file cannot be written; also raised by `add`.
    """

    def __init__(self, path: str | Path) -> None:
        given = Path(path)
        try:
            self.path, self._file = _create(given)
        except OSError as error:
            raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from None
        self._write(",".join(COLUMNS))

    def add(self, accepted: AcceptedScan) -> None:
        """Write a row, exactly as passed to the filter; nothing after the record has ended."""
        if not self.is_whole:
            return
        odometry, scan = accepted.measurement
        pose = ("", "", "") if odometry is None else map(repr, odometry.pose.tolist())
        laser = map(repr, (*accepted.mounting, accepted.angle_min, accepted.angle_increment))
        time_increment = "" if accepted.time_increment_s is None else repr(accepted.time_increment_s)
        cells = (
            format_stamp_ns(scan.stamp_ns),
            quote_name(scan.sensor),
            quote_name(scan.frame),
            *pose,
            "",
            *laser,
            time_increment,
            repr(scan.range_min_m),
            repr(scan.range_max_m),
            " ".join(map(repr, scan.ranges.tolist())),
        )
        self._write(",".join(cells))

    @property
    def is_whole(self) -> bool:
        """Whether the record contains all scans so far."""
        return not self._file.closed

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _write(self, line: str) -> None:
        rest = memoryview(line.encode() + b"\n")
        begin = self._file.tell()
        try:
            while rest:
                rest = rest[self._file.write(rest) :]
        except OSError as error:
            with suppress(OSError):
                self._file.truncate(begin)
            self._file.close()
            raise OutputError(f"{self.path}: {error.strerror or error}; the record ends before this scan") from None


def _create(given: Path) -> tuple[Path, IO[bytes]]:
    """Create a file of this name, or of the first numbered one that is free."""
    if given.exists() and not given.is_file():
        return given, given.open("wb", buffering=0)  # a device
    for number in count(1):
        path = given if number == 1 else given.with_name(f"{given.stem}-{number}{given.suffix}")
        with suppress(FileExistsError):
            return path, path.open("xb", buffering=0)
    raise AssertionError
