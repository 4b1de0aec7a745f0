"""From messages of a planar lidar to scans."""

from __future__ import annotations

from collections import OrderedDict
from typing import final

from gridslam.io.bags.ros_messages import ScanMessage
from gridslam.types import FloatArray, LaserScan, ScanGeometry

__all__ = ["BagScanBuilder"]
_KEPT = 64  # cheap lidars turn unevenly, so that each scan has angles of its own


_Key = tuple[float, float, int, int]


@final
class BagScanBuilder:
    """Makes scans whose geometries are shared as far as their angles and mountings are the same."""

    def __init__(self) -> None:
        self._geometries: OrderedDict[_Key, tuple[ScanGeometry, FloatArray]] = OrderedDict()

    def scan(self, message: ScanMessage, stamp_ns: int, sensor: str, base_from_laser: FloatArray) -> LaserScan:
        """Make a scan, by the rules of `LaserScan.from_ros`."""
        key = message.angle_min, message.angle_increment, len(message.ranges), id(base_from_laser)
        kept = self._geometries.get(key)
        scan = LaserScan.from_ros(
            stamp_ns, message.ranges, angle_min=message.angle_min, angle_increment=message.angle_increment,
            range_min=message.range_min, range_max=message.range_max, time_increment=message.time_increment,
            base_from_laser=base_from_laser, geometry=kept and kept[0], sensor=sensor, frame=message.frame,
        )  # fmt: skip
        if kept is None:
            self._geometries[key] = scan.geometry, base_from_laser  # kept too: while it is, nothing else has its id
            if len(self._geometries) > _KEPT:
                self._geometries.popitem(last=False)
        return scan
