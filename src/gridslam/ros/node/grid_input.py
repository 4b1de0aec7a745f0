"""Maps and poses that come as messages: by a topic, or with a request."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from gridslam.io.bags.ros_messages import MessageError
from gridslam.io.turned_maps import count_turned_cells, turn_cells
from gridslam.ros.node.messages import PLANAR, GridMessage
from gridslam.types import FloatArray

_MAX_CELLS: Final = 1 << 28
_ALMOST_ZERO: Final = 1e-6


def grid_of(message: Any) -> GridMessage:  # noqa: ANN401
    """Convert a decoded nav_msgs/OccupancyGrid, without its stamp; raises MessageError if it is none, or tilted."""
    info = message.info
    place, turn = info.origin.position, info.origin.orientation
    origin = place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w
    cells = np.asarray(message.data, np.int8)
    width, height, resolution = info.width, info.height, info.resolution
    if not (0 < width * height == len(cells) <= _MAX_CELLS and 0 < resolution < math.inf):
        raise MessageError(f"a map of {width} x {height} cells of {resolution:g} m with {len(cells)} values")
    if not all(map(math.isfinite, origin)):
        raise MessageError(f"a map with the origin {origin}")
    if max(abs(value) for value in origin[3:5]) > _ALMOST_ZERO:
        raise MessageError(f"a map that is tilted, by the quaternion {origin[3:]}")
    if cells.min() < -1 or cells.max() > 100:
        raise MessageError("a map with values that are not between -1 and 100")
    corner = origin[0], origin[1]
    own = cells.reshape(height, width)
    yaw = 2 * math.atan2(origin[5], origin[6])
    if abs(yaw) > _ALMOST_ZERO:
        if count_turned_cells(own.shape, yaw) > _MAX_CELLS:
            raise MessageError(f"a map of {width} x {height} cells that is turned by {yaw:g} rad")
        own, corner = turn_cells(own, resolution, corner, yaw, -1)
    return GridMessage(0, message.header.frame_id.lstrip("/"), float(resolution), corner, own)


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
