"""Programs of ROS 2 beside the node, by rclpy: a robot that drives, and one who listens and asks."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Iterable
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped, TransformStamped
from nav_msgs.msg import OccupancyGrid
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import LaserScan
from tf2_msgs.msg import TFMessage

from gridslam.io.bags.ros_messages import StampedTransform
from gridslam.io.measurement import Measurement
from support.ros_node import mounting, odometry_message, scan_message, until

BEST_EFFORT = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Peer:
    """A node of rclpy in a context of its own, which spins in a thread."""

    def __init__(self, domain: int, name: str = "peer") -> None:
        os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = rclpy.create_node(name, context=self.context)
        self._executor = SingleThreadedExecutor(context=self.context)
        self._nodes: list[Any] = []
        self.add(self.node)
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()

    def add(self, node: Any) -> None:
        """Let another node of the context spin, too."""
        self._nodes.append(node)
        self._executor.add_node(node)

    def _spin(self) -> None:
        while not self._closed.is_set():
            self._executor.spin_once(timeout_sec=0.1)

    def close(self) -> None:
        self._closed.set()
        self._thread.join()
        self._executor.shutdown()
        for node in self._nodes:
            node.destroy_node()
        rclpy.try_shutdown(context=self.context)

    def hear(self, topic: str, kind: Any, qos: Any = 100) -> list[Any]:
        """The messages of a topic, which go on to come."""
        heard: list[Any] = []
        self.node.create_subscription(kind, topic, heard.append, qos)
        return heard

    def ask(self, service: str, kind: Any, **fields: Any) -> Any:
        """Ask a service, which is waited for."""
        client = self.node.create_client(kind, service)
        assert client.wait_for_service(20), service
        answered = client.call_async(kind.Request(**fields))
        assert until(answered.done, 20), service
        self.node.destroy_client(client)
        return answered.result()

    def matched(self, publisher: Any) -> bool:
        return publisher.get_subscription_count() > 0


def stamped(message: Any, stamp_ns: int) -> Any:
    message.sec, message.nanosec = divmod(stamp_ns, 10**9)
    return message


def transform(link: StampedTransform) -> TFMessage:
    one = TransformStamped()
    stamped(one.header.stamp, link.stamp_ns)
    one.header.frame_id, one.child_frame_id = link.parent, link.child
    place, turn = one.transform.translation, one.transform.rotation
    place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w = map(float, link.pose)
    return TFMessage(transforms=[one])


def scan(measurement: Measurement, shift_ns: int) -> LaserScan:
    given = scan_message(measurement, shift_ns)
    message = LaserScan(ranges=given.ranges.tolist())
    stamped(message.header.stamp, given.stamp_ns)
    message.header.frame_id = given.frame
    message.angle_min, message.angle_increment = given.angle_min, given.angle_increment
    message.angle_max = given.angle_min + given.angle_increment * (len(given.ranges) - 1)
    message.range_min, message.range_max = given.range_min, given.range_max
    return message


class Robot(Peer):
    """Publishes what a robot does, and hears what the node says of it."""

    def __init__(self, domain: int, scans: str = "/scan", *, fixed: bool = True) -> None:
        super().__init__(domain, "robot")
        make = self.node.create_publisher
        self.scans = make(LaserScan, scans, BEST_EFFORT)
        self.moving = make(TFMessage, "/tf", 100)
        self.fixed = make(TFMessage, "/tf_static", LATCHED)
        self.clock = make(Clock, "/clock", BEST_EFFORT)
        if fixed:
            self.fixed.publish(transform(mounting()))
        self.poses = self.hear("/gridslam/pose", PoseWithCovarianceStamped)
        self.links = self.hear("/tf", TFMessage, 1000)
        self.status = self.hear("/diagnostics", DiagnosticArray)
        self.sent: list[int] = []

    def meets(self) -> bool:
        """Wait until the node listens, has the static transform, and is heard."""
        topics = self.scans, self.moving, self.fixed
        count = len(self.status)
        met = until(lambda: all(map(self.matched, topics)) and len(self.status) > count, 30)
        time.sleep(0.3)
        return met

    def drive(self, measurements: Iterable[Measurement], rate_hz: float = 40.0, *, clock: bool = False) -> None:
        """Send odometry and scans in real time, stamped as sent; or by a simulated clock, as they are stamped."""
        due = time.monotonic()
        for one in measurements:
            shift = SHIFT_NS if clock else time.time_ns() - one.scan.stamp_ns
            if clock:
                self.tell_time(one.scan.stamp_ns + shift)
            self.moving.publish(transform(odometry_message(one, shift)))
            message = scan(one, shift)
            self.scans.publish(message)
            self.sent.append(one.scan.stamp_ns + shift)
            due += 1 / rate_hz
            time.sleep(max(0.0, due - time.monotonic()))

    def stands_until_mapped(self, one: Measurement, node: Any) -> bool:
        """Send a measurement again and again until the node maps: by rclpy what is latched may come after 2 s."""
        end = time.monotonic() + 20
        while time.monotonic() < end:
            self.drive([one])
            if node.says("mapping", seconds=0.0):
                return True
        return False

    def tell_time(self, stamp_ns: int) -> None:
        message = Clock()
        stamped(message.clock, stamp_ns)
        self.clock.publish(message)

    def tells(self, name: str, least: int) -> bool:
        """Wait until the node's diagnostics say so much."""
        return until(lambda: bool(self.status) and int(values(self.status[-1]).get(name, 0)) >= least)

    def links_of(self, parent: str = "map") -> list[int]:
        """Stamps of the transforms from a frame that have come."""
        found = [one for message in list(self.links) for one in message.transforms]
        return [nanoseconds(one.header.stamp) for one in found if one.header.frame_id == parent]


SHIFT_NS = 1_700_000_000 * 10**9


def nanoseconds(stamp: Any) -> int:
    return int(stamp.sec * 10**9 + stamp.nanosec)


def values(status: DiagnosticArray) -> dict[str, str]:
    return {pair.key: pair.value for pair in status.status[0].values}


def last_map(peer: Peer, topic: str = "/map") -> OccupancyGrid:
    """The map that a late subscriber gets."""
    heard = peer.hear(topic, OccupancyGrid, LATCHED)
    assert until(lambda: bool(heard), 30)
    return heard[-1]
