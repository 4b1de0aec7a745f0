"""Messages published by the node as bytes, independent of the transport."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from contextlib import suppress
from typing import Any, final

import numpy as np

from gridslam.io.bags.encoder import MessageEncoder, Values
from gridslam.ros.node.messages import (
    PLANAR,
    CloudMessage,
    Diagnostics,
    GridMessage,
    Level,
    PoseMessage,
    StampedTransform,
)
from gridslam.ros.node.transport import ALL_TOPICS, TOPICS


@final
class EncodedOutputs:
    """Encodes the outputs of the core; see `Outputs`.

    Parameters
    ----------
    encoder : MessageEncoder
        Of ROS 1 or ROS 2.
    publish : callable
        Called with the name of one of `TOPICS` and the bytes.
    now_ns : callable
        The node's clock.
    log : callable
        Reports to the user.
    name : str
        Name of the node.

    Attributes
    ----------
    topics : collection of str
        Those that are published.
    """

    def __init__(
        self,
        encoder: MessageEncoder,
        publish: Callable[[str, bytes], None],
        now_ns: Callable[[], int],
        log: Callable[[Level, str], None],
        name: str,
    ) -> None:
        self._encoder = encoder
        self._publish = publish
        self._name = name
        self.topics: Collection[str] = TOPICS
        self.now_ns = now_ns
        self._log = log

    def log(self, level: Level, text: str) -> None:
        """Report to the user, as long as there is one: the terminal may have been closed."""
        with suppress(OSError, ValueError):
            self._log(level, text)

    def map(self, message: GridMessage) -> None:
        """Publish the map and its metadata."""
        values = grid_values(self._encoder, "map", message)
        self._send("map_metadata", *values[1])
        self._send("map", *values)

    def transform(self, message: StampedTransform) -> None:
        """Publish on /tf."""
        pose = message.pose
        header = self._encoder.header("/tf", message.stamp_ns, message.parent)
        self._send("/tf", [(header, message.child, (pose[:3], pose[3:]))])

    def updated_pose(self, message: PoseMessage) -> None:
        """Publish on amcl_pose."""
        self.pose(message, "amcl_pose")

    def pose(self, message: PoseMessage, topic: str = "~/pose") -> None:
        """Publish a pose with its covariance."""
        x, y, theta = message.pose.tolist()
        covariance = np.zeros((6, 6))
        covariance[PLANAR] = message.covariance
        turn = (0.0, 0.0, math.sin(0.5 * theta), math.cos(0.5 * theta))
        header = self._encoder.header(topic, message.stamp_ns, message.frame)
        self._send(topic, header, (((x, y, 0.0), turn), covariance.ravel()))

    def entropy(self, nats: float) -> None:
        """Publish on ~/entropy."""
        self._send("~/entropy", nats)

    def particles(self, message: CloudMessage) -> None:
        """Publish on particlecloud and, where it is a topic, on particle_cloud, directly from memory."""
        self._send_rows("particlecloud", message, message.data)
        if "particle_cloud" in self.topics:
            self._send_rows("particle_cloud", message, message.weighted_data)

    def _send_rows(self, topic: str, message: CloudMessage, data: Callable[[], bytes]) -> None:
        """Publish a message that ends with a sequence of structures of 8-byte numbers."""
        header = self._encoder.header(topic, message.stamp_ns, message.frame)
        head = self._encoder.encode(ALL_TOPICS[topic], header, [])[:-4] + len(message.poses).to_bytes(4, "little")
        padding = 0 if self._encoder.is_ros1 else (4 - len(head)) % 8
        self._publish(topic, head + bytes(padding) + data())

    def diagnostics(self, message: Diagnostics) -> None:
        """Publish on /diagnostics."""
        status = (int(message.level), f"{self._name}: SLAM", message.summary, "", list(message.values.items()))
        self._send("/diagnostics", self._encoder.header("/diagnostics", self.now_ns(), ""), [status])

    def _send(self, topic: str, *values: Any) -> None:  # noqa: ANN401
        self._publish(topic, self._encoder.encode(ALL_TOPICS[topic], *values))


def grid_values(encoder: MessageEncoder, topic: str, message: GridMessage) -> Values:
    """Return the fields of nav_msgs/OccupancyGrid."""
    height, width = message.cells.shape
    x, y = message.origin
    origin = (x, y, 0.0), (0.0, 0.0, 0.0, 1.0)
    info = divmod(message.stamp_ns, 1_000_000_000), message.resolution_m, width, height, origin
    return encoder.header(topic, message.stamp_ns, message.frame), info, message.cells.ravel()
