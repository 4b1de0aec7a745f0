"""Initial pose from the user: geometry_msgs/PoseWithCovarianceStamped, as RViz sends it on `initialpose`."""

from __future__ import annotations

import math
import struct

import numpy as np

from gridslam.errors import ArgumentError
from gridslam.io.bags.ros_messages import MessageError, Wire
from gridslam.ros.node.core import NodeCore

__all__ = ["set_pose_from_message"]

_PLANAR = np.ix_((0, 1, 5), (0, 1, 5))  # x, y and yaw of x, y, z, roll, pitch, yaw


def set_pose_from_message(core: NodeCore, data: bytes, wire: Wire) -> None:
    """Set the pose of the robot from a message; raises MessageError if it is not a pose in the node's map."""
    try:
        frame, end = wire.string(data, 12)
        if wire.aligned:
            end += (4 - end) & 7
        x, y, _, qx, qy, qz, qw = wire.pose.unpack_from(data, end)
        covariance = np.array(struct.unpack_from(f"{wire.order}36d", data, end + wire.pose.size)).reshape(6, 6)
    except struct.error as error:
        raise MessageError(str(error)) from None
    if frame != core.settings.map_frame:
        raise MessageError(f"expected a pose in the frame {core.settings.map_frame}, got {frame!r}")
    yaw = math.atan2(2 * (qw * qz + qx * qy), 1 - 2 * (qy * qy + qz * qz))
    try:
        core.set_pose((np.array([x, y, yaw]), covariance[_PLANAR]))
    except ArgumentError as error:
        raise MessageError(str(error)) from None
