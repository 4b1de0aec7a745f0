"""Maps that come as messages: by a topic, or with a request."""

from __future__ import annotations

import math
import struct
from typing import Any, Final

import numpy as np

from gridslam.io.bags.ros_messages import MessageError, Wire
from gridslam.ros.node.messages import GridMessage
from gridslam.types import OccupancyGrid

__all__ = ["decode_grid", "grid_of", "make_occupancy_grid"]

_SURE: Final = 0.98  # probability between a cell of 0 and one of 100
_MAX_CELLS: Final = 1 << 28
_ALMOST_ZERO_RAD: Final = 1e-6


def decode_grid(data: bytes, wire: Wire) -> GridMessage:
    """Decode nav_msgs/OccupancyGrid; raises MessageError if it is none, or a rotated one."""
    try:
        stamp = struct.unpack_from(f"{wire.order}II", data, 4)
        frame, at = wire.string(data, 12)
        at = (at + 3) & ~3 if wire.aligned else at
        resolution, width, height = struct.unpack_from(f"{wire.order}8xfII", data, at)
        at += 20
        at = at + (4 - at) % 8 if wire.aligned else at
        origin = wire.pose.unpack_from(data, at)
        at += wire.pose.size
        (count,) = wire.count.unpack_from(data, at)
        cells = np.frombuffer(data, np.int8, count, at + 4)
    except (struct.error, ValueError) as error:
        raise MessageError(str(error)) from None
    return _make(stamp[0] * 1_000_000_000 + stamp[1], frame, resolution, (width, height), origin, cells)


def grid_of(message: Any) -> GridMessage:  # noqa: ANN401
    """Convert a decoded nav_msgs/OccupancyGrid of rospy, rclpy or rosbags; raises MessageError if it is rotated."""
    info = message.info
    place, turn = info.origin.position, info.origin.orientation
    origin = place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w
    cells = np.asarray(message.data, np.int8)
    return _make(0, message.header.frame_id.lstrip("/"), info.resolution, (info.width, info.height), origin, cells)


def make_occupancy_grid(message: GridMessage) -> OccupancyGrid:
    """Return the map of a message: 0 to 100 in per cent become probabilities from 0.01 to 0.99."""
    probability = (1 - _SURE) / 2 + _SURE * np.arange(101) / 100.0
    log_odds = np.append(np.log(probability / (1 - probability)), 0.0).astype(np.float32)  # the last: of -1, unknown
    return OccupancyGrid(log_odds[message.cells], message.cells >= 0, message.resolution_m, message.origin)


def _make(
    stamp_ns: int,
    frame: str,
    resolution: float,
    size: tuple[int, int],
    origin: tuple[float, ...],
    cells: Any,  # noqa: ANN401
) -> GridMessage:
    width, height = size
    if not (0 < width * height == len(cells) <= _MAX_CELLS and 0 < resolution < math.inf):
        raise MessageError(f"a map of {width} x {height} cells of {resolution:g} m with {len(cells)} values")
    if not all(map(math.isfinite, origin)):
        raise MessageError(f"a map with the origin {origin}")
    if max(abs(value) for value in origin[3:6]) > _ALMOST_ZERO_RAD:
        raise MessageError("a rotated map: rotate its image instead")
    if cells.min() < -1 or cells.max() > 100:
        raise MessageError("a map with values that are not between -1 and 100")
    return GridMessage(stamp_ns, frame, float(resolution), (origin[0], origin[1]), cells.reshape(height, width))
