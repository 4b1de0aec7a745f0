"""From messages of a planar lidar to scans."""

from __future__ import annotations

import math
from collections import OrderedDict
from typing import final

import numpy as np

from gridslam.io.measurement import LONGEST_SCAN_S
from gridslam.io.ros_messages import ScanMessage
from gridslam.types import BeamStatus, FloatArray, LaserScan, ScanGeometry

__all__ = ["ScanMaker"]
_KEPT = 64  # cheap lidars turn unevenly, so that each scan has angles of its own
_INVALID = np.uint8(BeamStatus.INVALID)
_SMALLEST = 5e-324  # a range of 0 is none


_Key = tuple[float, float, int, int]


@final
class ScanMaker:
    """Makes scans whose geometries are shared as far as their angles and mountings are the same."""

    def __init__(self) -> None:
        self._geometries: OrderedDict[_Key, tuple[ScanGeometry, FloatArray]] = OrderedDict()

    def scan(self, message: ScanMessage, stamp_ns: int, sensor: str, base_from_laser: FloatArray) -> LaserScan:
        """Make a scan, by the rules of `LaserScan.from_ranges`.

        A maximum that is not above the minimum and 0 is no maximum, a minimum below 0 or NaN no minimum. A time
        increment by which the scan takes 10 s or more is none.
        """
        lower = message.range_min if message.range_min > 0 else 0.0
        upper = message.range_max if message.range_max > lower else math.inf
        with np.errstate(invalid="ignore"):  # of NaNs that signal
            ranges = message.ranges.astype(np.float64)
        status = (ranges >= upper).view(np.uint8)  # 0 and 1: HIT and NO_RETURN
        status[~(ranges >= (lower or _SMALLEST))] = _INVALID
        ranges.flags.writeable = status.flags.writeable = False
        times = self._times(message)
        geometry = self._geometry(message, base_from_laser)
        return LaserScan(stamp_ns, ranges, status, geometry, lower, upper, sensor, message.frame, times)

    def _geometry(self, message: ScanMessage, base_from_laser: FloatArray) -> ScanGeometry:
        key = message.angle_min, message.angle_increment, len(message.ranges), id(base_from_laser)
        kept = self._geometries.get(key)
        if kept is not None:
            return kept[0]
        bearings = message.angle_min + message.angle_increment * np.arange(len(message.ranges))
        geometry = ScanGeometry(bearings, base_from_laser)
        self._geometries[key] = geometry, base_from_laser  # kept too: while it is, nothing else has its id
        if len(self._geometries) > _KEPT:
            self._geometries.popitem(last=False)
        return geometry

    def _times(self, message: ScanMessage) -> FloatArray | None:
        increment = message.time_increment
        if not (increment > 0 and increment * len(message.ranges) < LONGEST_SCAN_S):
            return None
        times: FloatArray = np.arange(len(message.ranges), dtype=np.float64)
        times *= increment
        times.flags.writeable = False
        return times
