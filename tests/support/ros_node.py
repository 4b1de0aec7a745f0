"""Stands in for a transport: keeps what the node says, and plays logs to it as a robot would."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future
from typing import Any

import numpy as np

from gridslam.io.bags.encoder import MessageEncoder
from gridslam.io.measurement import Measurement
from gridslam.ros import NodeCore
from gridslam.ros.node.messages import (
    CloudMessage,
    Diagnostics,
    GridMessage,
    Level,
    PoseMessage,
    ScanMessage,
    StampedTransform,
)
from gridslam.types import BeamStatus

BASE, ODOM, LASER = "base_link", "odom", "laser"


class RecordedOutputs:
    """Outputs that are kept; its clock stands at the stamp of the last scan that `play` sent."""

    def __init__(self) -> None:
        self.clock_ns = 0
        self.maps: list[GridMessage] = []
        self.transforms: list[StampedTransform] = []
        self.poses: list[PoseMessage] = []
        self.updated_poses: list[PoseMessage] = []
        self.topics: tuple[str, ...] = ()
        self.entropies: list[float] = []
        self.clouds: list[CloudMessage] = []
        self.logs: list[tuple[Level, str]] = []
        self.reports: list[Diagnostics] = []
        self.hold: threading.Event | None = None  # the map's publisher waits for it

    def now_ns(self) -> int:
        return self.clock_ns

    def map(self, message: GridMessage) -> None:
        if not self.topics or "map" in self.topics:  # as a transport, which publishes what was announced
            self.maps.append(message)
        if self.hold is not None:
            self.hold.wait(10)

    def transform(self, message: StampedTransform) -> None:
        self.transforms.append(message)

    def pose(self, message: PoseMessage) -> None:
        self.poses.append(message)

    def updated_pose(self, message: PoseMessage) -> None:
        self.updated_poses.append(message)

    def entropy(self, nats: float) -> None:
        self.entropies.append(nats)

    def particles(self, message: CloudMessage) -> None:
        self.clouds.append(message)

    def diagnostics(self, message: Diagnostics) -> None:
        self.reports.append(message)

    def log(self, level: Level, text: str) -> None:
        self.logs.append((level, text))

    def warnings(self) -> str:
        return "\n".join(text for _, text in self.logs)


class LocalTransport:
    """A transport without a network: `RosNode` runs on it, and `play` reaches its core."""

    global_localization = "global_localization"
    encoder = MessageEncoder(is_ros1=False)

    def __init__(self) -> None:
        self.outputs = RecordedOutputs()
        self.shut_down = threading.Event()
        self.services: dict[str, Callable[[object], Any]] = {}
        self.handlers: dict[str, Callable[[bytes], None]] = {}

    def connect(self, refuse: Callable[[str, str], None], topics: dict[str, str]) -> None:
        self.refuse = refuse
        self.published = topics
        self.outputs.topics = tuple(topics)

    def resolve(self, topic: str) -> str:
        return f"/{topic}"

    def subscribe(self, topic: str, kind: str, handle: Callable[[bytes], None], **qos: object) -> None:
        self.handlers[topic] = handle

    def advertise(self, service: str, kind: str, serve: Callable[[object], Any], **options: bool) -> None:
        self.services[service] = serve

    def spin(self, ended: threading.Event) -> Iterator[None]:
        while not self.shut_down.is_set() and not ended.wait(0.01):
            yield

    def close(self) -> None:
        self.shut_down.set()


def scan_message(measurement: Measurement, shift_ns: int = 0, **changes: object) -> ScanMessage:
    """What a driver would send."""
    scan = measurement.scan
    ranges = np.where(scan.status == BeamStatus.HIT, scan.ranges, np.inf).astype(np.float32)
    bearings = scan.geometry.bearings
    step = np.float32((bearings[-1] - bearings[0]) / (len(bearings) - 1))
    message = ScanMessage(
        scan.stamp_ns + shift_ns,
        LASER,
        float(np.float32(bearings[0])),
        float(step),
        0.0,
        0.02,
        float(np.float32(min(scan.range_max_m, 80.0))),
        ranges,
    )
    return message._replace(**changes)


def odometry_message(measurement: Measurement, shift_ns: int = 0) -> StampedTransform:
    """The link of the odometry at a scan's stamp."""
    x, y, theta = measurement.odometry.pose.tolist()
    pose = (x, y, 0.0, 0.0, 0.0, float(np.sin(theta / 2)), float(np.cos(theta / 2)))
    return StampedTransform(measurement.odometry.stamp_ns + shift_ns, ODOM, BASE, pose)


def mounting(x: float = 0.1, yaw: float = 0.02) -> StampedTransform:
    """Where the laser sits, turned in space a little."""
    quaternion = np.array([0.01, -0.005, np.sin(yaw / 2), 1.0])
    quaternion /= np.linalg.norm(quaternion)
    return StampedTransform(0, BASE, LASER, (x, 0.03, 0.2, *quaternion.tolist()))


def until(true: Callable[[], bool], seconds: float = 20.0) -> bool:
    """Wait for something, not longer than that."""
    end = time.monotonic() + seconds
    while not true():
        if time.monotonic() > end:
            return False
        time.sleep(0.002)
    return True


def in_filter(core: NodeCore, call: Callable[[], Any] = lambda: None) -> Any:
    """Run a call in the filter's thread between two scans; give what it returns."""
    answer: Future[Any] = Future()
    core._queue.post(lambda: answer.set_result(call()))
    return answer.result(60.0)


def play(
    core: NodeCore, outputs: RecordedOutputs, measurements: Iterable[Measurement], *, shift_ns: int = 0, ahead: int = 20
) -> int:
    """Send scans and odometry, never more than `ahead` scans before the filter; returns how many."""
    counts, sent = core._queue.counts, 0  # the counts tell how far the filter is
    for measurement in measurements:
        before = counts.received - 1
        assert until(lambda: counts.received - counts.accepted - counts.refused - counts.dropped < ahead), before
        outputs.clock_ns = measurement.scan.stamp_ns + shift_ns
        core.on_transforms([odometry_message(measurement, shift_ns)])
        core.on_scan(scan_message(measurement, shift_ns), "/scan")
        sent += 1
    return sent
