"""The three kinds of ROS messages that a log of a planar lidar consists of, decoded from their bytes.

Frames are given without leading "/": "/laser" and "laser" are one frame.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gridslam.io.bags.encoder import MessageEncoder, MessageError

Values = tuple[float, float, float, float, float, float, float]
"""Position in m and quaternion xyzw, as the message has them: not necessarily finite or of norm 1."""

_KINDS = {
    "sensor_msgs/LaserScan": "scan",
    "nav_msgs/Odometry": "odometry",
    "tf2_msgs/TFMessage": "transforms",
    "tf/tfMessage": "transforms",
}


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


def kind_of(message_type: str) -> str:
    """Return "scan", "odometry" or "transforms" for a type as ROS 1 or ROS 2 names it; "" for all others."""
    return _KINDS.get(message_type.replace("/msg/", "/"), "")


def decode_scan(data: bytes, encoder: MessageEncoder) -> ScanMessage:
    """Decode a scan; its ranges view `data`. Raises MessageError where the bytes are none, or its angles not finite."""
    message = encoder.decode("sensor_msgs/LaserScan", data)
    start, increment = message.angle_min, message.angle_increment
    if not math.isfinite(start + increment):
        raise MessageError(f"its angles are from {start} in steps of {increment} rad")
    return ScanMessage(
        *_stamp_and_frame(message.header),
        start,
        increment,
        message.time_increment,
        message.range_min,
        message.range_max,
        message.ranges,
        message.angle_max,
        len(message.intensities),
    )


def decode_odometry(data: bytes, encoder: MessageEncoder) -> OdometryMessage:
    """Decode an odometry message; raises MessageError where the bytes are none."""
    message = encoder.decode("nav_msgs/Odometry", data)
    pose = message.pose.pose
    child = message.child_frame_id.lstrip("/")
    return OdometryMessage(*_stamp_and_frame(message.header), child, _values(pose.position, pose.orientation))


def decode_transforms(data: bytes, encoder: MessageEncoder) -> list[StampedTransform]:
    """Decode a message of transforms; raises MessageError where the bytes are none."""
    found = []
    for each in encoder.decode("tf2_msgs/TFMessage", data).transforms:
        pose = _values(each.transform.translation, each.transform.rotation)
        found.append(StampedTransform(*_stamp_and_frame(each.header), each.child_frame_id.lstrip("/"), pose))
    return found


def _stamp_and_frame(header: Any) -> tuple[int, str]:  # noqa: ANN401
    return header.stamp.sec * 1_000_000_000 + header.stamp.nanosec, header.frame_id.lstrip("/")


def _values(place: Any, turn: Any) -> Values:  # noqa: ANN401
    return place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w
