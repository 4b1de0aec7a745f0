"""Writes small bags through rosbags, message by message: what the reader of bags is tested with."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

KINDS = ("ros1", "db3", "mcap")
START_NS = 1_700_000_000_000_000_000
_TF = "geometry_msgs/TransformStamped[] transforms\n"


class Said(NamedTuple):
    """A message: its topic, when it was recorded, and what it is."""

    topic: str
    time_ns: int
    type: str
    make: Any


def ns(seconds: float) -> int:
    """Stamp of a time after the start."""
    return START_NS + round(seconds * 1e9)


def yawed(yaw: float) -> tuple[float, float, float, float]:
    """Quaternion of a turn about the vertical."""
    return 0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)


def scan(
    topic: str,
    at_s: float,
    ranges: Sequence[float],
    *,
    frame: str = "laser",
    stamp_s: float | None = None,
    angles: tuple[float, float] = (-1.0, 0.25),
    time_increment: float = 0.0,
    limits: tuple[float, float] = (0.1, 30.0),
    stamped: bool = True,
    angle_max: float | None = None,
    intensities: Sequence[float] = (),
) -> Said:
    """A scan; its stamp is the time of recording, and its last angle that of the last beam, unless told."""

    def make(maker: Maker) -> object:
        header = maker.header((at_s if stamp_s is None else stamp_s) if stamped else None, frame)
        values = np.array(ranges, dtype=np.float32)
        start, step = angles
        end = start + step * (len(values) - 1) if angle_max is None else angle_max
        bright = np.array(intensities, dtype=np.float32)
        return maker.types["sensor_msgs/msg/LaserScan"](
            header, start, end, step, time_increment, 0.1, *limits, values, bright
        )

    return Said(topic, ns(at_s), "sensor_msgs/msg/LaserScan", make)


def odometry(
    topic: str,
    at_s: float,
    pose: Sequence[float],
    *,
    frames: tuple[str, str] = ("odom", "base_link"),
    stamp_s: float | None = None,
) -> Said:
    """A planar pose."""

    def make(maker: Maker) -> object:
        types = maker.types
        x, y, yaw = pose
        where = types["geometry_msgs/msg/Pose"](
            types["geometry_msgs/msg/Point"](x, y, 0.0), types["geometry_msgs/msg/Quaternion"](*yawed(yaw))
        )
        zero = types["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
        return types["nav_msgs/msg/Odometry"](
            maker.header(at_s if stamp_s is None else stamp_s, frames[0]),
            frames[1],
            types["geometry_msgs/msg/PoseWithCovariance"](where, np.zeros(36)),
            types["geometry_msgs/msg/TwistWithCovariance"](types["geometry_msgs/msg/Twist"](zero, zero), np.zeros(36)),
        )

    return Said(topic, ns(at_s), "nav_msgs/msg/Odometry", make)


def transform(
    at_s: float,
    parent: str,
    child: str,
    place: Sequence[float] = (0.0, 0.0, 0.0),
    xyzw: Sequence[float] = (0.0, 0.0, 0.0, 1.0),
    *,
    topic: str = "/tf_static",
    stamp_s: float | None = None,
) -> Said:
    """One link."""

    def make(maker: Maker) -> object:
        types = maker.types
        link = types["geometry_msgs/msg/TransformStamped"](
            maker.header(at_s if stamp_s is None else stamp_s, parent),
            child,
            types["geometry_msgs/msg/Transform"](
                types["geometry_msgs/msg/Vector3"](*place), types["geometry_msgs/msg/Quaternion"](*xyzw)
            ),
        )
        return types["tf2_msgs/msg/TFMessage"]([link])

    return Said(topic, ns(at_s), "tf2_msgs/msg/TFMessage", make)


class Maker:
    """Makes and serializes messages of ROS 1 or ROS 2."""

    def __init__(self, ros1: bool) -> None:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        self.ros1 = ros1
        self.store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
        if ros1:
            self.store.register(get_types_from_msg(_TF, "tf2_msgs/msg/TFMessage"))
        own = get_types_from_msg("float64 secret\nstring word\n", "own_msgs/msg/Custom")
        self.store.register(own)
        self.types = self.store.types

    def header(self, stamp_s: float | None, frame: str) -> object:
        seconds, nanoseconds = (0, 0) if stamp_s is None else divmod(ns(stamp_s), 10**9)
        stamp = self.types["builtin_interfaces/msg/Time"](seconds, nanoseconds)
        make = self.types["std_msgs/msg/Header"]
        return make(0, stamp, frame) if self.ros1 else make(stamp, frame)

    def bytes_of(self, said: Said, little_endian: bool = True) -> bytes:
        message = said.make(self)
        if self.ros1:
            return bytes(self.store.serialize_ros1(message, said.type))
        return bytes(self.store.serialize_cdr(message, said.type, little_endian=little_endian))


@cache
def _maker(ros1: bool) -> Maker:
    """Return a maker that all bags share: each compiles the types of messages."""
    return Maker(ros1)


def write(
    folder: Path,
    kind: str,
    messages: Iterable[Said],
    compression: str = "",
    name: str = "log",
    altered: Callable[[bytes], bytes] = bytes,
) -> Path:
    """Write messages in the order given; `compression` is bz2 or lz4 (ROS 1), file, message or storage (ROS 2).

    The bytes of each message are what `altered` makes of them.
    """
    from rosbags import rosbag1, rosbag2

    maker = _maker(kind == "ros1")
    if kind == "ros1":
        path = folder / f"{name}.bag"
        writer: Any = rosbag1.Writer(path)
        if compression:
            writer.set_compression(rosbag1.Writer.CompressionFormat[compression.upper()])
    else:
        path = folder / name
        plugin = rosbag2.StoragePlugin.MCAP if kind == "mcap" else rosbag2.StoragePlugin.SQLITE3
        writer = rosbag2.Writer(path, version=9, storage_plugin=plugin)
        if compression:
            writer.set_compression(rosbag2.CompressionMode[compression.upper()], rosbag2.CompressionFormat.ZSTD)
    connections: dict[str, Any] = {}
    with writer:
        for said in messages:
            if said.topic not in connections:
                connections[said.topic] = writer.add_connection(said.topic, said.type, typestore=maker.store)
            writer.write(connections[said.topic], said.time_ns, altered(maker.bytes_of(said)))
    return path


def drive(
    duration_s: float = 2.0,
    *,
    scans: bool = True,
    mounting: bool = True,
) -> list[Said]:
    """A robot that drives 1 m/s along x, turning 0.1 rad/s: scans at 10 Hz, odometry at 20 Hz, a laser 0.2 m ahead."""
    said = [transform(0.0, "base_link", "laser", (0.2, 0.0, 0.3))] if mounting else []
    for step in range(round(duration_s * 20) + 1):
        at_s = step / 20
        said.append(odometry("/odom", at_s, (at_s, 0.0, 0.1 * at_s)))
        if scans and step % 2:
            said.append(scan("/scan", at_s + 0.01, [1.0 + at_s, 2.0, 3.0, 4.0]))
    return said
