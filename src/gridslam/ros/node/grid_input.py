"""Poses that come as messages: by a topic, or with a request."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from gridslam.ros.node.messages import PLANAR
from gridslam.types import FloatArray


def pose_of(message: Any) -> FloatArray:  # noqa: ANN401
    """Return the pose (3,) in the plane of a decoded geometry_msgs/Pose or Pose2D."""
    if hasattr(message, "theta"):
        return np.array([message.x, message.y, message.theta])
    place, turn = message.position, message.orientation
    yaw = math.atan2(2 * (turn.w * turn.z + turn.x * turn.y), 1 - 2 * (turn.y**2 + turn.z**2))
    return np.array([place.x, place.y, yaw])


def covariance_of(message: Any) -> FloatArray:  # noqa: ANN401
    """Return the covariance (3, 3) in the plane of a decoded geometry_msgs/PoseWithCovariance."""
    return np.asarray(message.covariance, np.float64).reshape(6, 6)[PLANAR]
