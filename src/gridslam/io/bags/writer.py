"""Writer of ROS bags: ROS 1, ROS 2 in sqlite3 and in mcap, without ROS."""

from __future__ import annotations

import math
import os
import re
import sqlite3
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, Final, NamedTuple, final

import numpy as np
from numpy.typing import NDArray
from rosbags import rosbag1, rosbag2
from rosbags.interfaces import Connection, Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

from gridslam.errors import ArgumentError, OutputError
from gridslam.geometry import rigid, se2
from gridslam.io.bags.encoder import MessageEncoder, Values
from gridslam.io.even_beams import find_step, find_time_increment, require_hits_within_limits
from gridslam.io.measurement import Measurement
from gridslam.io.output import write_atomically
from gridslam.types import BeamStatus, FloatArray, LaserScan, Odometry

_FILES = {".bag": "ros1", ".mcap": "mcap", ".db3": "sqlite3"}
_ROS2_VERSION: Final = 8  # of the metadata: the later 9 is not read by ROS 2 before Jazzy
_ALWAYS = QosTime(0, 0)
_LATCHED = Qos(
    QosHistory.KEEP_LAST,
    1,
    QosReliability.RELIABLE,
    QosDurability.TRANSIENT_LOCAL,
    _ALWAYS,
    _ALWAYS,
    QosLiveliness.AUTOMATIC,
    _ALWAYS,
    False,
)

_ODOMETRY = "nav_msgs/msg/Odometry"
_SCAN = "sensor_msgs/msg/LaserScan"
_TRANSFORMS = "tf2_msgs/msg/TFMessage"
_TOPIC = re.compile(r"(/[A-Za-z]\w*)+", re.ASCII)
_ODOM = "odom"
_BASE = "base_link"
_EVEN_RAD = 1e-5
_EVEN_S = 1e-6
_UNKNOWN = np.zeros(36)
_NOTHING = np.array([0.0, np.inf, np.nan], dtype=np.float32)  # by status
_TINY = np.finfo(np.float32).tiny


def write_bag(path: str | Path, measurements: Iterable[Measurement]) -> None:
    """Write a log as a bag, to be read by `BagLog` and played to a robot's software.

    Scans stand in /scan; those of a sensor that is named like a topic in that one, of further sensors in
    /scan_<sensor>. INVALID beams are NaN, those without return infinite. Odometry stands in /odom, with its mean
    velocity since the reading before, and in /tf as odom -> base_link.
    The laser's mounting stands in /tf_static as base_link -> its frame. Stamps and poses come back exactly, ranges and
    bearings to single precision.

    Headers carry the stamps as they are. The times of recording, by which a bag is read, are the same where these
    ascend, and later by as many ns as it takes to keep the log's order where they do not.

    Parameters
    ----------
    path : str or Path
        A ROS 1 bag where it ends in .bag, a ROS 2 bag in one file where it ends in .mcap or .db3, and otherwise the
        folder of a ROS 2 bag (sqlite3). It appears under its name only once it is whole. A file is replaced.
    measurements : iterable of Measurement
        In the order in which they are to stand in the log; may be a generator.

    Raises
    ------
    ArgumentError
        For data that messages cannot represent: beams that are not evenly spread in angle or in time, a mounting that
        changes, hits outside the range limits, stamps before 0 or from 2^31 s on; and for a log without any scan.
    OutputError
        Where the bag cannot be written, or a folder is in its place.
    """
    target = Path(path)
    if target.is_dir() and (target.suffix in _FILES or any(target.iterdir())):
        raise OutputError(f"{path}: expected a name for a new bag, but there is a folder")
    kind = _FILES.get(target.suffix, "sqlite3")
    if kind == "sqlite3" and set("?#%") & set(str(target)):
        raise OutputError(f"{path}: a path with ?, # or % cannot hold a sqlite3 bag: write .mcap, or elsewhere")
    try:
        with write_atomically(target) as aside:
            if kind == "ros1" or target.suffix not in _FILES:
                _write(aside, kind, measurements)
            else:
                folder = aside.with_suffix("")
                _write(folder, kind, measurements)
                os.replace(folder / aside.name, aside)
    except sqlite3.Error as error:
        raise OutputError(f"{path}: cannot be written: {error}") from None


def _write(path: Path, kind: str, measurements: Iterable[Measurement]) -> None:
    """Write all messages in the log's order, at times of recording that ascend strictly."""
    is_ros1 = kind == "ros1"
    encoder = MessageEncoder(is_ros1=is_ros1)
    messages = _Messages(encoder)
    connections: dict[str, Connection] = {}
    recorded_ns = 0  # ROS 1 has no message at time 0
    bag: Any = (
        rosbag1.Writer(path)
        if is_ros1
        else rosbag2.Writer(path, version=_ROS2_VERSION, storage_plugin=rosbag2.StoragePlugin[kind.upper()])
    )
    with bag:
        for measurement in measurements:
            for topic, message_type, stamp_ns, values in messages.of(measurement):
                if topic not in connections:
                    latched = topic == "/tf_static"
                    options: dict[str, Any] = (
                        {"callerid": "/gridslam", "latching": 1 if latched else None}
                        if is_ros1
                        else {"offered_qos_profiles": [_LATCHED] if latched else []}
                    )
                    connections[topic] = bag.add_connection(topic, message_type, typestore=encoder.store, **options)
                recorded_ns = max(recorded_ns + 1, stamp_ns)
                bag.write(connections[topic], recorded_ns, encoder.encode(message_type, *values))
        if not recorded_ns:
            raise ArgumentError("measurements", "at least one scan", "none")


class _Message(NamedTuple):
    """One message: its topic, its type, its header's stamp in ns, and the values of its fields."""

    topic: str
    type: str
    stamp_ns: int
    values: Values


class _Sensor(NamedTuple):
    """Topic and frame of a laser, and its mounting (4, 4)."""

    topic: str
    frame: str
    mounting: FloatArray


@final
class _Messages:
    """Converts measurements to messages, one after another; see `write_bag`."""

    def __init__(self, encoder: MessageEncoder) -> None:
        self._header = encoder.header
        self._odometry: Odometry | None = None
        self._sensors: dict[str, _Sensor] = {}

    def of(self, measurement: Measurement) -> Iterator[_Message]:
        """Yield messages of one measurement, in the order in which a robot would send them."""
        odometry, scan = measurement
        if odometry is not None and not _same(odometry, self._odometry):
            stamp_ns = odometry.stamp_ns
            pose = _in_space(odometry.pose)
            header = self._header("/odom", stamp_ns, _ODOM)
            twist = _twist(self._odometry, odometry)
            yield _Message("/odom", _ODOMETRY, stamp_ns, (header, _BASE, (pose, _UNKNOWN), (twist, _UNKNOWN)))
            yield _Message("/tf", _TRANSFORMS, stamp_ns, ([(self._header("/tf", stamp_ns, _ODOM), _BASE, pose)],))
            self._odometry = odometry
        if scan.sensor not in self._sensors:
            self._sensors[scan.sensor] = self._new_sensor(scan)
            yield _Message("/tf_static", _TRANSFORMS, scan.stamp_ns, (self._mountings(scan.stamp_ns),))
        sensor = self._sensors[scan.sensor]
        yield _Message(sensor.topic, _SCAN, scan.stamp_ns, self._scan(scan, sensor))

    def _mountings(self, stamp_ns: int) -> list[Values]:
        """Return all mountings known so far: who comes late is given the last message alone."""
        by_frame = {sensor.frame: sensor.mounting for sensor in self._sensors.values() if sensor.frame != _BASE}
        return [
            (self._header("/tf_static", stamp_ns, _BASE), frame, tuple(np.split(rigid.from_matrix(mounting), [3])))
            for frame, mounting in by_frame.items()
        ]

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

    def _scan(self, scan: LaserScan, sensor: _Sensor) -> Values:
        mounting = scan.geometry.base_from_laser
        if mounting is not sensor.mounting and not np.allclose(mounting, sensor.mounting, rtol=0, atol=1e-6):
            expected = f"one mounting for all scans of '{scan.sensor}'"
            raise ArgumentError("base_from_laser", expected, mounting.tolist())
        angle_min, step = find_step("bearings", scan.geometry.bearings, _EVEN_RAD)
        increment_s = 0.0 if scan.beam_times_s is None else find_time_increment(scan.beam_times_s, _EVEN_S)
        if increment_s < 0:
            raise ArgumentError("beam_times_s", "times that grow from 0 at the first beam", scan.beam_times_s)
        header = self._header(sensor.topic, scan.stamp_ns, sensor.frame)
        angles = angle_min, angle_min + step * max(len(scan) - 1, 0), step
        times = increment_s, increment_s * len(scan)
        return header, *angles, *times, scan.range_min_m, scan.range_max_m, _ranges(scan), ()


def _same(a: Odometry, b: Odometry | None) -> bool:
    return b is not None and (a is b or (a.stamp_ns == b.stamp_ns and bool((a.pose == b.pose).all())))


def _in_space(pose: FloatArray) -> Values:
    """Return translation (3,) and quaternion xyzw (4,) of a planar pose."""
    x, y, theta = pose.tolist()
    return (x, y, 0.0), (0.0, 0.0, math.sin(theta / 2), math.cos(theta / 2))


def _twist(before: Odometry | None, now: Odometry) -> Values:
    """Mean linear and angular velocity (3,) since the last odometry, in the base frame; 0 if unknown."""
    vx = vy = omega = 0.0
    if before is not None and now.stamp_ns > before.stamp_ns:
        seconds = (now.stamp_ns - before.stamp_ns) / 1e9
        vx, vy, omega = (se2.log(se2.between(before.pose, now.pose)) / seconds).tolist()
    return (vx, vy, 0.0), (0.0, 0.0, omega)


def _ranges(scan: LaserScan) -> NDArray[np.float32]:
    """Return ranges as a message has them: NO_RETURN is infinite, INVALID is NaN."""
    require_hits_within_limits(scan)
    hit = scan.status == BeamStatus.HIT
    ranges = _NOTHING[scan.status]
    # Rounding to single precision must not turn a hit into "no return" or "invalid".
    below = np.nextafter(np.float32(scan.range_max_m), np.float32(0))
    ranges[hit] = scan.ranges[hit].astype(np.float32).clip(_TINY, below)
    return ranges
