"""From a scan's message to the measurement that is mapped and recorded: the record is read back to the same bits."""

from __future__ import annotations

import math
from collections import OrderedDict
from dataclasses import replace
from typing import NamedTuple, final

import numpy as np

from gridslam.io.csv_columns import angles_of_rotation, rotation_of_angles
from gridslam.io.measurement import Measurement
from gridslam.io.ros_messages import ScanMessage
from gridslam.types import BeamStatus, FloatArray, LaserScan, Odometry, ScanGeometry

__all__ = ["Accepted", "LaserForm", "ScanMaker", "refusal_of"]

_KEPT = 64  # cheap lidars turn unevenly, so that each scan has angles of its own
_TURN_RAD = 6.3
_NOTHING = np.array([0.0, np.inf, np.nan])  # by status, of beams that hit nothing
_MOVED_M = 0.005  # and rad: what a mounting on /tf may flutter


class LaserForm(NamedTuple):
    """Laser properties in a record, number by number.

    Attributes
    ----------
    sensor, frame : str
        Topic and frame.
    mounting : tuple of 6 float
        x, y, z in m, roll, pitch and yaw in rad, of the laser in the base frame.
    angle_min, angle_increment : float, rad
        Of the beams.
    time_increment_s : float or None
        Between beams, if known.
    range_min_m, range_max_m : float, m
        Limits of the sensor.
    beams : int
        How many.
    """

    sensor: str
    frame: str
    mounting: tuple[float, ...]
    angle_min: float
    angle_increment: float
    time_increment_s: float | None
    range_min_m: float
    range_max_m: float
    beams: int


class Accepted(NamedTuple):
    """A measurement for the filter, the form of its laser, and when its message came (s, `time.perf_counter`)."""

    measurement: Measurement
    form: LaserForm
    arrived_s: float


def refusal_of(message: ScanMessage, least: int, most: int) -> str:
    """Reason why a message is not a scan to map; empty for a scan of `least` to `most` beams."""
    beams = len(message.ranges)
    if beams > most:
        return f"{beams} beams, more than the {most} that a scan may have"
    if beams < least:
        return f"{beams} beams are too few to localize; at least {least} are required"
    if not message.frame or not message.frame.isprintable() or message.frame != message.frame.strip():
        return f"expected the name of a frame, got {message.frame!r:.60}"
    if not isinstance(message.stamp_ns, int) or not 0 < message.stamp_ns < 1 << 63:
        return f"expected a stamp of more than 0 s, got {message.stamp_ns} ns"
    if message.range_min == math.inf:
        return "its least range is infinite, so that no range is valid"
    start, step = message.angle_min, message.angle_increment
    span = abs(step) * (beams - 1)
    if not (abs(start) <= 2 * _TURN_RAD and 0 < span <= _TURN_RAD + abs(step) < math.inf):
        return f"expected beams within one turn, got {beams} from {start:g} rad in steps of {step:g} rad"
    return ""


@final
class ScanMaker:
    """Makes measurements of one laser; geometries are shared as far as angles and mounting are the same.

    The mounting goes through its six numbers, and what hit nothing through `inf` and `nan`, as in the record.
    """

    def __init__(self) -> None:
        self._known: OrderedDict[tuple[float, ...], ScanGeometry] = OrderedDict()
        self._matrix: FloatArray = np.full((4, 4), np.nan)
        self._mounting: tuple[float, ...] = ()

    def measurement(
        self,
        message: ScanMessage,
        sensor: str,
        base_from_laser: FloatArray,
        odometry: Odometry | None,
        arrived_s: float,
    ) -> Accepted:
        """Make the measurement of a message that `refusal_of` has nothing against."""
        mounting, beams = self._mounted(base_from_laser), len(message.ranges)
        start, step, on_progress = (
            float(v) for v in (message.angle_min, message.angle_increment, message.time_increment)
        )
        scan = LaserScan.from_ros(
            message.stamp_ns, message.ranges, angle_min=start, angle_increment=step, range_min=message.range_min,
            range_max=message.range_max, time_increment=on_progress,
            geometry=self._shared(mounting, start, step, beams), sensor=sensor, frame=message.frame,
        )  # fmt: skip
        form = LaserForm(
            sensor, message.frame, mounting, start, step, None if scan.beam_times_s is None else on_progress,
            scan.range_min_m, scan.range_max_m, beams,
        )  # fmt: skip
        return Accepted(Measurement(odometry, replace(scan, ranges=_readable(scan))), form, arrived_s)

    def _mounted(self, matrix: FloatArray) -> tuple[float, ...]:
        if not np.abs(matrix - self._matrix).max() <= _MOVED_M:
            self._matrix = matrix
            values = *matrix[:3, 3].tolist(), *angles_of_rotation(matrix[:3, :3])
            self._mounting = tuple(value + 0.0 for value in values)  # no -0.0
        return self._mounting

    def _shared(self, mounting: tuple[float, ...], start: float, step: float, beams: int) -> ScanGeometry:
        key = *mounting, start, step, beams
        known = self._known.get(key)
        if known is None:
            matrix = np.eye(4)
            matrix[:3, :3], matrix[:3, 3] = rotation_of_angles(*mounting[3:]), mounting[:3]
            known = self._known[key] = ScanGeometry(start + step * np.arange(beams), matrix)
            if len(self._known) > _KEPT:
                self._known.popitem(last=False)
        return known


def _readable(scan: LaserScan) -> FloatArray:
    """Ranges (B,) of which only hits keep their value."""
    ranges: FloatArray = np.where(scan.status == BeamStatus.HIT, scan.ranges, _NOTHING[scan.status])
    ranges.flags.writeable = False
    return ranges
