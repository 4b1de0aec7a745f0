"""From a scan's message to the measurement that is mapped and recorded: the record is read back to the same bits."""

from __future__ import annotations

import math
from collections import OrderedDict
from typing import NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from gridslam.io.csv_columns import angles_of_rotation, rotation_of_angles
from gridslam.io.measurement import LONGEST_SCAN_S, Measurement
from gridslam.io.ros_messages import ScanMessage
from gridslam.types import FloatArray, LaserScan, Odometry, ScanGeometry

__all__ = ["Accepted", "LaserForm", "ScanMaker", "refusal_of"]

_KEPT = 64  # cheap lidars turn unevenly, so that each scan has angles of its own
_TURN_RAD = 6.3
_MOVED_M = 0.005  # and rad: what a mounting on /tf may flutter


class LaserForm(NamedTuple):
    """What a record says of a laser, number by number.

    Attributes
    ----------
    sensor, frame : str
        Topic and frame.
    mounting : tuple of 6 float
        x, y, z in m, roll, pitch and yaw in rad, of the laser in the base frame.
    angle_min, angle_increment : float, rad
        Of the beams.
    time_increment_s : float or None
        Between beams, where it is told.
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
    """Say why a message is no scan to be mapped; empty where it is one of `least` to `most` beams."""
    beams = len(message.ranges)
    if beams > most:
        return f"{beams} beams, more than the {most} that a scan may have"
    if beams < least:
        return f"{beams} beams are too few to tell where the robot is; at least {least} are needed"
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
        self._known: OrderedDict[LaserForm, tuple[ScanGeometry, FloatArray | None]] = OrderedDict()
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
        lower = float(message.range_min) if message.range_min > 0 else 0.0
        upper = float(message.range_max) if message.range_max > lower else math.inf
        tick = float(message.time_increment)
        timed = tick > 0 and tick * len(message.ranges) < LONGEST_SCAN_S
        form = LaserForm(
            sensor, message.frame, self._mounted(base_from_laser), float(message.angle_min),
            float(message.angle_increment), tick if timed else None, lower, upper, len(message.ranges),
        )  # fmt: skip
        geometry, times = self._shared(form)
        scan = LaserScan.from_ranges(
            message.stamp_ns, _readable(message.ranges, lower, upper), geometry, range_min_m=lower, range_max_m=upper,
            sensor=sensor, frame=message.frame, beam_times_s=times,
        )  # fmt: skip
        return Accepted(Measurement(odometry, scan), form, arrived_s)

    def _mounted(self, matrix: FloatArray) -> tuple[float, ...]:
        if not np.abs(matrix - self._matrix).max() <= _MOVED_M:
            self._matrix = matrix
            values = *matrix[:3, 3].tolist(), *angles_of_rotation(matrix[:3, :3])
            self._mounting = tuple(value + 0.0 for value in values)  # no -0.0
        return self._mounting

    def _shared(self, form: LaserForm) -> tuple[ScanGeometry, FloatArray | None]:
        known = self._known.get(form)
        if known is None:
            matrix, number = np.eye(4), np.arange(form.beams)
            matrix[:3, :3], matrix[:3, 3] = rotation_of_angles(*form.mounting[3:]), form.mounting[:3]
            tick = form.time_increment_s
            geometry = ScanGeometry(form.angle_min + form.angle_increment * number, matrix)
            known = self._known[form] = geometry, None if tick is None else number.astype(np.float64) * tick
            if len(self._known) > _KEPT:
                self._known.popitem(last=False)
        return known


def _readable(values: NDArray[np.float32], lower: float, upper: float) -> FloatArray:
    """Ranges (B,) of which only hits keep their value."""
    with np.errstate(invalid="ignore"):  # of NaNs that signal
        ranges: FloatArray = values.astype(np.float64)
    beyond = ranges >= upper
    ranges[~(ranges >= (lower or 5e-324))] = np.nan
    ranges[beyond] = np.inf
    return ranges
