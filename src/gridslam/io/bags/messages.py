"""What a measurement is in ROS: messages of its odometry, its scan and the transforms between them."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple, TypeAlias, final

import numpy as np
from numpy.typing import NDArray

from gridslam.errors import ArgumentError
from gridslam.geometry import se2, se3
from gridslam.io.measurement import Measurement
from gridslam.types import BeamStatus, FloatArray, LaserScan, Odometry, ScanGeometry

__all__ = ["BagMessage", "BagMessages"]

Message: TypeAlias = Any  # of a class that a typestore of rosbags made

_ODOMETRY, _SCAN, _TRANSFORMS = "nav_msgs/msg/Odometry", "sensor_msgs/msg/LaserScan", "tf2_msgs/msg/TFMessage"
_TOPIC = re.compile(r"(/[A-Za-z]\w*)+", re.ASCII)
_ODOM, _BASE = "odom", "base_link"
_EVEN_RAD, _EVEN_S = 1e-5, 1e-6
_MOST_GEOMETRIES = 256
_NO_FLOATS = np.zeros(0, dtype=np.float32)
_UNKNOWN = np.zeros(36)
_NOTHING = np.array([0.0, np.inf, np.nan], dtype=np.float32)  # by status
_TINY = np.finfo(np.float32).tiny


class BagMessage(NamedTuple):
    """One message: its topic, its type as ROS 2 names it, and its header's stamp in ns."""

    topic: str
    type: str
    stamp_ns: int
    message: Message


class _Sensor(NamedTuple):
    """Topic and frame of a laser, and its mounting (4, 4)."""

    topic: str
    frame: str
    mounting: FloatArray


@final
class BagMessages:
    """Converts measurements to messages, one after another; see `write_bag`.

    Parameters
    ----------
    types : mapping of str to type
        Classes of the messages by their names, as a typestore of rosbags has them.
    numbered : bool
        Whether headers carry a sequence number, as in ROS 1.
    """

    def __init__(self, types: Mapping[str, Any], *, numbered: bool) -> None:
        self._types = types
        self._numbered = numbered
        self._sequence: Counter[str] = Counter()
        self._odometry: Odometry | None = None
        self._sensors: dict[str, _Sensor] = {}
        self._times: tuple[FloatArray | None, float] = None, 0.0
        self._geometries: dict[int, tuple[ScanGeometry, float, float]] = {}

    def of(self, measurement: Measurement) -> Iterator[BagMessage]:
        """Messages of one measurement, in the order in which a robot would send them."""
        odometry, scan = measurement
        if odometry is not None and not _same(odometry, self._odometry):
            stamp_ns = odometry.stamp_ns
            yield BagMessage("/odom", _ODOMETRY, stamp_ns, self._odometry_message(odometry))
            link = self._transform("/tf", stamp_ns, _ODOM, _BASE, *_in_space(odometry.pose))
            yield BagMessage("/tf", _TRANSFORMS, stamp_ns, self._make(_TRANSFORMS, [link]))
            self._odometry = odometry
        if scan.sensor not in self._sensors:
            self._sensors[scan.sensor] = self._new_sensor(scan)
            yield BagMessage("/tf_static", _TRANSFORMS, scan.stamp_ns, self._mountings(scan.stamp_ns))
        sensor = self._sensors[scan.sensor]
        yield BagMessage(sensor.topic, _SCAN, scan.stamp_ns, self._scan_message(scan, sensor))

    def _make(self, name: str, *values: Message) -> Message:
        return self._types[name](*values)

    def _header(self, topic: str, stamp_ns: int, frame: str) -> Message:
        seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
        if not 0 <= seconds < 2**31:
            raise ArgumentError("stamp_ns", "a stamp that ROS can represent, from 0 on and below 2^31 s", stamp_ns)
        stamp = self._make("builtin_interfaces/msg/Time", seconds, nanoseconds)
        if not self._numbered:
            return self._make("std_msgs/msg/Header", stamp, frame)
        self._sequence[topic] += 1
        return self._make("std_msgs/msg/Header", self._sequence[topic] - 1, stamp, frame)

    def _transform(
        self, topic: str, stamp_ns: int, parent: str, child: str, translation: list[float], xyzw: list[float]
    ) -> Message:
        motion = self._make(
            "geometry_msgs/msg/Transform",
            self._make("geometry_msgs/msg/Vector3", *translation),
            self._make("geometry_msgs/msg/Quaternion", *xyzw),
        )
        return self._make("geometry_msgs/msg/TransformStamped", self._header(topic, stamp_ns, parent), child, motion)

    def _odometry_message(self, odometry: Odometry) -> Message:
        translation, xyzw = _in_space(odometry.pose)
        pose = self._make(
            "geometry_msgs/msg/Pose",
            self._make("geometry_msgs/msg/Point", *translation),
            self._make("geometry_msgs/msg/Quaternion", *xyzw),
        )
        vx, vy, omega = _twist(self._odometry, odometry)
        twist = self._make(
            "geometry_msgs/msg/Twist",
            self._make("geometry_msgs/msg/Vector3", vx, vy, 0.0),
            self._make("geometry_msgs/msg/Vector3", 0.0, 0.0, omega),
        )
        return self._make(
            _ODOMETRY,
            self._header("/odom", odometry.stamp_ns, _ODOM),
            _BASE,
            self._make("geometry_msgs/msg/PoseWithCovariance", pose, _UNKNOWN),
            self._make("geometry_msgs/msg/TwistWithCovariance", twist, _UNKNOWN),
        )

    def _mountings(self, stamp_ns: int) -> Message:
        """All mountings known so far: who comes late is given the last message alone."""
        by_frame = {sensor.frame: sensor.mounting for sensor in self._sensors.values() if sensor.frame != _BASE}
        links = []
        for frame, mounting in by_frame.items():
            translation, xyzw = (part.tolist() for part in se3.to_quaternion(mounting))
            links.append(self._transform("/tf_static", stamp_ns, _BASE, frame, translation, xyzw))
        return self._make(_TRANSFORMS, links)

    def _new_sensor(self, scan: LaserScan) -> _Sensor:
        """Choose topic and frame: the log's own names where ROS can have them and nothing else does."""
        topics = {"/odom", "/tf", "/tf_static", *(sensor.topic for sensor in self._sensors.values())}
        topic = scan.sensor
        if not _TOPIC.fullmatch(topic):
            topic = "/scan_" + re.sub(r"\W", "_", topic, flags=re.ASCII) if self._sensors else "/scan"
        mounting = scan.geometry.base_from_laser
        frames = {sensor.frame: sensor.mounting for sensor in self._sensors.values()}
        frames |= {_ODOM: np.zeros((4, 4)), _BASE: np.eye(4)}
        frame = scan.frame.lstrip("/") or "laser"
        while topic in topics:
            topic += "_2"
        while frame in frames and not np.allclose(frames[frame], mounting, rtol=0, atol=1e-6):
            frame += "_2"
        return _Sensor(topic, frame, mounting)

    def _scan_message(self, scan: LaserScan, sensor: _Sensor) -> Message:
        angle_min, step = self._angles(scan, sensor)
        if scan.beam_times_s is not self._times[0]:  # scans of a laser often share them
            self._times = scan.beam_times_s, _time_increment_s(scan.beam_times_s)
        time_increment = self._times[1]
        return self._make(
            _SCAN,
            self._header(sensor.topic, scan.stamp_ns, sensor.frame),
            angle_min,
            angle_min + step * max(len(scan) - 1, 0),
            step,
            time_increment,
            time_increment * len(scan),
            scan.range_min_m,
            scan.range_max_m,
            _ranges(scan),
            _NO_FLOATS,
        )

    def _angles(self, scan: LaserScan, sensor: _Sensor) -> tuple[float, float]:
        """First bearing and step of a scan, looked at once for each geometry."""
        geometry = scan.geometry
        known = self._geometries.get(id(geometry))
        if known is None:
            if not np.allclose(geometry.base_from_laser, sensor.mounting, rtol=0, atol=1e-6):
                got = geometry.base_from_laser.tolist()
                raise ArgumentError("base_from_laser", f"one mounting for all scans of '{scan.sensor}'", got)
            if len(self._geometries) >= _MOST_GEOMETRIES:
                self._geometries.clear()
            known = self._geometries[id(geometry)] = geometry, *_even("bearings", geometry.bearings, _EVEN_RAD)
        return known[1], known[2]


def _same(a: Odometry, b: Odometry | None) -> bool:
    return b is not None and (a is b or (a.stamp_ns == b.stamp_ns and bool((a.pose == b.pose).all())))


def _in_space(pose: FloatArray) -> tuple[list[float], list[float]]:
    """Translation (3,) and quaternion xyzw (4,) of a planar pose."""
    x, y, theta = pose.tolist()
    return [x, y, 0.0], [0.0, 0.0, math.sin(theta / 2), math.cos(theta / 2)]


def _twist(before: Odometry | None, now: Odometry) -> list[float]:
    """Mean velocity since the last odometry, in the base frame; 0 if unknown."""
    if before is None or now.stamp_ns <= before.stamp_ns:
        return [0.0, 0.0, 0.0]
    seconds = (now.stamp_ns - before.stamp_ns) / 1e9
    velocity: list[float] = (se2.log(se2.between(before.pose, now.pose)) / seconds).tolist()
    return velocity


def _even(name: str, values: FloatArray, tolerance: float) -> tuple[float, float]:
    """First value and step of evenly spread ones."""
    if len(values) < 2:
        return float(values.sum()), 0.0
    step = float(values[-1] - values[0]) / (len(values) - 1)
    if not (np.abs(values - values[0] - step * np.arange(len(values))) <= tolerance).all():
        raise ArgumentError(name, "evenly spread beams, which is all that a message can represent", values)
    return float(values[0]), step


def _time_increment_s(times: FloatArray | None) -> float:
    if times is None:
        return 0.0
    first, step = _even("beam_times_s", times, _EVEN_S)
    if abs(first) > _EVEN_S or step < 0:
        raise ArgumentError("beam_times_s", "times that grow from 0 at the first beam", times)
    return step


def _ranges(scan: LaserScan) -> NDArray[np.float32]:
    """Ranges as a message has them: NO_RETURN is infinite, INVALID is NaN."""
    hit = scan.status == BeamStatus.HIT
    hits = scan.ranges[hit]
    nearest, farthest = hits.min(initial=np.inf), hits.max(initial=0.0)
    if hits.size and not (nearest > 0 and scan.range_min_m <= nearest and farthest < scan.range_max_m):
        limits = f"hits from {scan.range_min_m:g} m on and below {scan.range_max_m:g} m"
        raise ArgumentError("ranges", limits, (float(nearest), float(farthest)))
    ranges = _NOTHING[scan.status]
    # Rounding to single precision must not turn a hit into "no return" or "invalid".
    below = np.nextafter(np.float32(scan.range_max_m), np.float32(0))
    ranges[hit] = hits.astype(np.float32).clip(_TINY, below)
    return ranges
