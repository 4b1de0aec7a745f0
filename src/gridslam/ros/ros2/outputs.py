"""Messages published by the node in ROS 2, as bytes, independent of the transport."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, final

import numpy as np

from gridslam.ros.node.messages import CloudMessage, Diagnostics, GridMessage, Level, PoseMessage, StampedTransform
from gridslam.ros.node.transport import TOPICS
from gridslam.ros.ros2.cdr import encode_message

__all__ = ["Ros2Outputs", "grid_values"]

_LEVEL_TURN = (0.0, 0.0, 0.0, 1.0)


@final
class Ros2Outputs:
    """Encodes the outputs of the core.

    Parameters
    ----------
    publish : callable
        Called with the name of one of `TOPICS` and the bytes.
    now_ns : callable
        The node's clock.
    log : callable
        Reports to the user.
    name : str
        Name of the node.
    """

    def __init__(
        self,
        publish: Callable[[str, bytes], None],
        now_ns: Callable[[], int],
        log: Callable[[Level, str], None],
        name: str,
    ) -> None:
        self._publish, self._now_ns, self._log, self._name = publish, now_ns, log, name

    def now_ns(self) -> int:
        """Return the current time, simulated or not, ns."""
        return self._now_ns()

    def log(self, level: Level, text: str) -> None:
        """Report to the user."""
        self._log(level, text)

    def map(self, message: GridMessage) -> None:
        """Publish the map and its metadata."""
        values = grid_values(message)
        self._send("map_metadata", values[1])
        self._send("map", values)

    def transform(self, message: StampedTransform) -> None:
        """Publish on /tf."""
        pose = message.pose
        link = (_header(message.stamp_ns, message.parent), message.child, (pose[:3], pose[3:]))
        self._send("/tf", ([link],))

    def pose(self, message: PoseMessage) -> None:
        """Publish on ~/pose."""
        x, y, theta = message.pose.tolist()
        full = np.zeros((6, 6))
        full[np.ix_((0, 1, 5), (0, 1, 5))] = message.covariance
        turn = (0.0, 0.0, math.sin(0.5 * theta), math.cos(0.5 * theta))
        self._send("~/pose", (_header(message.stamp_ns, message.frame), (((x, y, 0.0), turn), full.ravel().tolist())))

    def entropy(self, nats: float) -> None:
        """Publish on ~/entropy."""
        self._send("~/entropy", (nats,))

    def particles(self, message: CloudMessage) -> None:
        """Publish on particlecloud, directly from memory."""
        head = encode_message(TOPICS["particlecloud"], (_header(message.stamp_ns, message.frame), []))[:-4]
        head += len(message.poses).to_bytes(4, "little")
        self._publish("particlecloud", head + bytes((4 - len(head)) % 8) + message.data())

    def diagnostics(self, message: Diagnostics) -> None:
        """Publish on /diagnostics."""
        status = (int(message.level), f"{self._name}: SLAM", message.summary, "", list(message.values.items()))
        self._send("/diagnostics", (_header(self.now_ns(), ""), [status]))

    def _send(self, topic: str, values: Any) -> None:  # noqa: ANN401
        self._publish(topic, encode_message(TOPICS[topic], values))


def grid_values(message: GridMessage) -> tuple[Any, ...]:
    """Return the fields of nav_msgs/OccupancyGrid."""
    height, width = message.cells.shape
    x, y = message.origin
    origin = (x, y, 0.0), _LEVEL_TURN
    info = _stamp(message.stamp_ns), message.resolution_m, width, height, origin
    return _header(message.stamp_ns, message.frame), info, message.cells.tobytes()


def _stamp(stamp_ns: int) -> tuple[int, int]:
    return divmod(stamp_ns, 1_000_000_000)


def _header(stamp_ns: int, frame: str) -> tuple[tuple[int, int], str]:
    return _stamp(stamp_ns), frame
