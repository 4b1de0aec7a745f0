"""The three kinds of ROS messages that a log of a planar lidar consists of, decoded from their bytes.

ROS 1 packs the fields one after another, little-endian; ROS 2 writes CDR: two bytes for the byte order, two of
options, then the fields, each aligned to its size (strings end with a zero, which their length counts). Both begin a
header with four bytes that do not matter here, seconds, nanoseconds and the frame's name. Frames are given without
leading "/": "/laser" and "laser" are one frame.

Source: wiki.ros.org/ROS/Technical Overview (message serialization); OMG, DDS-XTypes 1.3, section 7.4.3 (plain CDR).
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass, field
from functools import lru_cache
from typing import NamedTuple, final

import numpy as np
from numpy.typing import NDArray

Values = tuple[float, float, float, float, float, float, float]
"""Position in m and quaternion xyzw, as the message has them: not necessarily finite or of norm 1."""

_KINDS = {
    "sensor_msgs/LaserScan": "scan",
    "nav_msgs/Odometry": "odometry",
    "tf2_msgs/TFMessage": "transforms",
    "tf/tfMessage": "transforms",
}


class MessageError(ValueError):
    """The bytes are no such message."""


class ScanMessage(NamedTuple):
    """sensor_msgs/LaserScan: angles in rad, times in s, ranges (B,) float32 in m, and how many intensities there are.

    `angle_max` is NaN where it is not stated.
    """

    stamp_ns: int
    frame: str
    angle_min: float
    angle_increment: float
    time_increment: float
    range_min: float
    range_max: float
    ranges: NDArray[np.float32]
    angle_max: float = math.nan
    intensities: int = 0


class OdometryMessage(NamedTuple):
    """nav_msgs/Odometry, without its covariance and twist: pose of `child_frame` in `frame`."""

    stamp_ns: int
    frame: str
    child_frame: str
    pose: Values


class StampedTransform(NamedTuple):
    """geometry_msgs/TransformStamped: pose of frame `child` in frame `parent`."""

    stamp_ns: int
    parent: str
    child: str
    pose: Values


@final
@dataclass(frozen=True, slots=True)
class Wire:
    """How numbers and strings lie in the bytes.

    Attributes
    ----------
    order : str
        Byte order, as `struct` writes it.
    aligned : bool
        Whether each field begins at a multiple of its size, counted from byte 4.
    """

    order: str
    aligned: bool
    count: struct.Struct = field(init=False)
    header: struct.Struct = field(init=False)
    scan: struct.Struct = field(init=False)
    pose: struct.Struct = field(init=False)

    def __post_init__(self) -> None:
        """Compile the layouts."""
        for name, layout in (("count", "I"), ("header", "III"), ("scan", "7fI"), ("pose", "7d")):
            object.__setattr__(self, name, struct.Struct(self.order + layout))

    def string(self, data: bytes, begin: int) -> tuple[str, int]:
        """Read the string at `begin`, where its length is stored; return it and its end."""
        if self.aligned:
            begin = (begin + 3) & ~3
        start = begin + 4
        end = start + self.count.unpack_from(data, begin)[0]
        if end > len(data):
            raise MessageError("a name ends behind the message")
        return _frame(data[start:end]), end


_ROS1 = Wire("<", False)
_CDR_LITTLE = Wire("<", True)
_CDR_BIG = Wire(">", True)


def wire_of_ros1(data: bytes) -> Wire:
    """Return the encoding of a ROS 1 message, which is always the same."""
    return _ROS1


def wire_of_cdr(data: bytes) -> Wire:
    """Detect the encoding of a ROS 2 message from its first bytes; raises MessageError unless it is plain CDR."""
    if data[:2] == b"\x00\x01":
        return _CDR_LITTLE
    if data[:2] == b"\x00\x00":
        return _CDR_BIG
    raise MessageError(f"expected plain CDR (00 00 or 00 01), got {data[:2].hex(' ') or 'nothing'}")


def kind_of(message_type: str) -> str:
    """Return "scan", "odometry" or "transforms" for a type as ROS 1 or ROS 2 names it; "" for all others."""
    return _KINDS.get(message_type.replace("/msg/", "/"), "")


@lru_cache(maxsize=4096)
def _frame(name: bytes) -> str:
    return name.rstrip(b"\0").decode("utf-8", "replace").lstrip("/")


def decode_scan(data: bytes, wire: Wire) -> ScanMessage:
    """Decode a scan; its ranges view `data`. Raises MessageError where the bytes are none, or its angles not finite."""
    try:
        seconds, nanoseconds, _ = wire.header.unpack_from(data, 4)
        frame, end = wire.string(data, 12)
        if wire.aligned:
            end = (end + 3) & ~3
        start, stop, increment, time_increment, _, range_min, range_max, count = wire.scan.unpack_from(data, end)
        ranges = np.frombuffer(data, wire.order + "f4", count, end + 32)
        behind = end + 32 + 4 * count
        intensities = wire.count.unpack_from(data, behind)[0] if len(data) >= behind + 4 else 0
    except (struct.error, ValueError) as error:
        raise MessageError(str(error)) from None
    if not math.isfinite(start + increment):
        raise MessageError(f"its angles are from {start} in steps of {increment} rad")
    return ScanMessage(
        seconds * 1_000_000_000 + nanoseconds,
        frame,
        start,
        increment,
        time_increment,
        range_min,
        range_max,
        ranges,
        stop,
        intensities,
    )


def decode_odometry(data: bytes, wire: Wire) -> OdometryMessage:
    """Decode an odometry message; raises MessageError where the bytes are none."""
    try:
        seconds, nanoseconds, _ = wire.header.unpack_from(data, 4)
        frame, end = wire.string(data, 12)
        child, end = wire.string(data, end)
        if wire.aligned:
            end += (4 - end) & 7
        pose = wire.pose.unpack_from(data, end)
    except struct.error as error:
        raise MessageError(str(error)) from None
    return OdometryMessage(seconds * 1_000_000_000 + nanoseconds, frame, child, pose)


def decode_transforms(data: bytes, wire: Wire) -> list[StampedTransform]:
    """Decode a message of transforms; raises MessageError where the bytes are none."""
    found = []
    try:
        end = 4 if wire.aligned else 0
        (left,) = wire.count.unpack_from(data, end)
        end += 4
        while left:
            begin = (end + 3) & ~3 if wire.aligned else end + 4  # ROS 1: behind the header's sequence number
            seconds, nanoseconds, _ = wire.header.unpack_from(data, begin)
            parent, end = wire.string(data, begin + 8)
            child, end = wire.string(data, end)
            if wire.aligned:
                end += (4 - end) & 7
            pose = wire.pose.unpack_from(data, end)
            found.append(StampedTransform(seconds * 1_000_000_000 + nanoseconds, parent, child, pose))
            end += 56
            left -= 1
    except struct.error as error:
        raise MessageError(str(error)) from None
    return found
