"""A robot on the wire of ROS 2, by cyclonedds with messages as Python objects: nothing of the package encodes here."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from gridslam.io.measurement import Measurement
from gridslam.ros.node.service_types import service_encoder
from support.ros_node import mounting, odometry_message, scan_message

LOOPBACK = (
    "<CycloneDDS><Domain><General><Interfaces><NetworkInterface address='127.0.0.1'/></Interfaces>"
    "<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex>"
    "<MaxAutoParticipantIndex>60</MaxAutoParticipantIndex><Peers><Peer address='127.0.0.1'/></Peers></Discovery>"
    "</Domain></CycloneDDS>"
)


_HELD: list[socket.socket] = []


def free_domain() -> int:
    """A domain that no other process of these tests uses: each holds a lock on one of its ports."""
    for k in range(99):
        domain = 1 + (os.getpid() + k) % 99
        held = socket.socket()
        try:
            held.bind(("127.0.0.1", 7400 + 250 * domain))  # of TCP, which DDS leaves alone
        except OSError:
            held.close()
            continue
        _HELD.append(held)
        return domain
    raise OSError("all domains are in use")


FIELDS = service_encoder().fields


class Peer:
    """Talks by cyclonedds with messages as Python objects: nothing of the package encodes or decodes here."""

    def __init__(self, domain: int) -> None:
        from cyclonedds.domain import Domain, DomainParticipant

        self.domain = Domain(domain, LOOPBACK)
        self.participant = DomainParticipant(domain)
        self.kinds: dict[str, Any] = {}

    def kind(self, name: str) -> Any:
        from cyclonedds.idl import make_idl_struct, types

        if name not in self.kinds:
            fields = {}
            for field, element, length in FIELDS(name):
                one = {"string": str, "bool": bool, "byte": types.uint8}.get(element)
                one = one or (self.kind(element) if "/" in element else getattr(types, element))
                if length is not None:
                    one = types.array[one, length] if length else types.sequence[one]
                fields[field] = one
            package, *_, short = name.split("/")
            space = "srv" if short.endswith(("_Request", "_Response")) else "msg"
            self.kinds[name] = make_idl_struct(f"{short}_", f"{package}.{space}.dds_.{short}_", fields)
        return self.kinds[name]

    def make(self, name: str, *values: Any) -> Any:
        """A message of nested tuples."""
        made = []
        for (_, element, length), value in zip(FIELDS(name), values, strict=True):
            nested = "/" in element
            if nested and length is not None:
                made.append([self.make(element, *one) for one in value])
            else:
                made.append(self.make(element, *value) if nested else value)
        return self.kind(name)(*made)

    def writer(self, topic: str, name: str, *, latched: bool = False, reliable: bool = True) -> Any:
        from cyclonedds.pub import DataWriter

        return DataWriter(self.participant, self.topic(topic, name), self.qos(latched, reliable))

    def reader(self, topic: str, name: str, *, latched: bool = False, depth: int = 100) -> Any:
        from cyclonedds.sub import DataReader

        return DataReader(self.participant, self.topic(topic, name), self.qos(latched, True, depth))

    def topic(self, topic: str, name: str) -> Any:
        from cyclonedds.topic import Topic

        return Topic(self.participant, topic, self.kind(name))

    def qos(self, latched: bool, reliable: bool, depth: int = 100) -> Any:
        from cyclonedds.qos import Policy, Qos
        from cyclonedds.util import duration

        return Qos(
            Policy.Reliability.Reliable(duration(seconds=1)) if reliable else Policy.Reliability.BestEffort,
            Policy.Durability.TransientLocal if latched else Policy.Durability.Volatile,
            Policy.History.KeepLast(depth),
            Policy.DataRepresentation(use_cdrv0_representation=True),
        )


def stamp(stamp_ns: int) -> tuple[int, int]:
    return divmod(stamp_ns, 10**9)


def until(true: Callable[[], bool], seconds: float = 60.0) -> bool:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if true():
            return True
        time.sleep(0.01)
    return False


def got(reader: Any, seconds: float = 60.0) -> Any:
    """The last message that comes."""
    found: list[Any] = []
    assert until(lambda: bool(found.extend(reader.take(100)) or found), seconds)
    return found[-1]


def transforms(peer: Peer, links: Sequence[Any]) -> Any:
    return peer.make(
        "tf2_msgs/TFMessage",
        [((stamp(at), parent), child, (pose[:3], pose[3:])) for at, parent, child, pose in links],
    )


class Robot:
    """Drives, and waits after each scan for what the node says of it."""

    def __init__(self, peer: Peer) -> None:
        self.peer, self.static_told = peer, False
        self.scans = peer.writer("rt/scan", "sensor_msgs/LaserScan", reliable=False)
        self.moving = peer.writer("rt/tf", "tf2_msgs/TFMessage")
        self.fixed = peer.writer("rt/tf_static", "tf2_msgs/TFMessage", latched=True)
        self.poses = peer.reader("rt/gridslam/pose", "geometry_msgs/PoseWithCovarianceStamped")
        self.status = peer.reader("rt/diagnostics", "diagnostic_msgs/DiagnosticArray")
        self.known: set[int] = set()
        self.told: dict[str, str] = {}

    def meets(self) -> bool:
        """Wait for a node that was not met yet to listen to all that is sent, and to be heard."""
        writers, readers = (self.scans, self.moving, self.fixed), (self.poses, self.status)

        def new() -> list[set[int]]:
            found = [set(writer.get_matched_subscriptions()) for writer in writers]
            found += [set(reader.get_matched_publications()) for reader in readers]
            return [handles - self.known for handles in found]

        met = until(lambda: all(new()))
        self.known |= set().union(*new())
        if not self.static_told:
            self.fixed.write(transforms(self.peer, [mounting()]))
            self.static_told = True
        return met

    def drive(self, measurements: Sequence[Measurement]) -> int:
        """Send scans and odometry, stamped now; returns for how many the node told a pose."""
        heard = 0
        shift = time.time_ns() - measurements[0].scan.stamp_ns
        for one in measurements:
            self.moving.write(transforms(self.peer, [odometry_message(one, shift)]))
            self.send(scan_message(one, shift))
            heard += until(lambda: bool(self.poses.take(100)), 5.0)
        return heard

    def send(self, message: Any) -> None:
        """Send a scan."""
        values = message.angle_min, 0.0, message.angle_increment, 0.0, 0.0, message.range_min, message.range_max
        header = stamp(message.stamp_ns), message.frame
        self.scans.write(self.peer.make("sensor_msgs/LaserScan", header, *values, message.ranges.tolist(), []))

    def tells(self, name: str, least: int) -> bool:
        """Wait until the node's diagnostics say so much."""

        def enough() -> bool:
            for message in self.status.take(100):
                self.told = {pair.key: pair.value for pair in message.status[0].values}
                self.told["says"] = message.status[0].message
            return int(self.told.get(name, 0)) >= least

        return until(enough)


class Node:
    """The command, in a process of its own."""

    def __init__(
        self, domain: int, log: Path, *arguments: str, interface: str = "127.0.0.1", transport: str = "dds"
    ) -> None:
        others = "ROS", "CYCLONE", "FASTRTPS", "PYTHON"
        environment = {name: value for name, value in os.environ.items() if not name.startswith(others)}
        environment["ROS_DOMAIN_ID"] = str(domain)
        command = [sys.executable, "-m", "gridslam", "ros2", "--transport", transport]
        if transport == "rclpy":
            environment["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
        elif interface:
            command += ["--interface", interface]
        else:
            environment["ROS_LOCALHOST_ONLY"] = "1"
        self.log = log
        with log.open("w") as out:
            self.process = subprocess.Popen([*command, *arguments], env=environment, stderr=out, start_new_session=True)

    def says(self, words: str, seconds: float = 60.0) -> bool:
        """Wait for words in its log, as long as it runs."""
        until(lambda: words in self.log.read_text() or self.process.poll() is not None, seconds)
        return words in self.log.read_text()

    def end(self, number: int = signal.SIGINT) -> int:
        """Ctrl-C, or another signal."""
        if self.process.poll() is None:
            self.process.send_signal(number)
        return self.process.wait(60)

    def kill(self) -> None:
        """End it without a word."""
        self.process.kill()
        self.process.wait(60)
