"""The node on the wire of ROS 2: another process, with the library's own encoding, talks with it on loopback."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ros_node import mounting, odometry_message, scan_message

from gridslam.ros.cdr import fields_of
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate

cyclonedds = pytest.importorskip("cyclonedds", reason="Cyclone DDS (the extra ros2) is not installed")

LOOPBACK = (
    "<CycloneDDS><Domain><General><Interfaces><NetworkInterface address='127.0.0.1'/></Interfaces>"
    "<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex>"
    "<MaxAutoParticipantIndex>60</MaxAutoParticipantIndex><Peers><Peer address='127.0.0.1'/></Peers></Discovery>"
    "</Domain></CycloneDDS>"
)
NODE = """
import sys
from gridslam.cli.interrupt import handled_signals
from gridslam.cli.ros import ros2
with handled_signals():
    ros2(sys.argv[1:], transport="dds", interfaces=["127.0.0.1"])
"""


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
            for element, length, field in fields_of(name):
                one = {"string": str, "bool": bool}.get(element)
                one = one or (self.kind(element) if "/" in element else getattr(types, element))
                if length is not None:
                    one = types.array[one, length] if length else types.sequence[one]
                fields[field] = one
            package, short = name.split("/")
            space = "srv" if short.endswith(("_Request", "_Response")) else "msg"
            self.kinds[name] = make_idl_struct(f"{short}_", f"{package}.{space}.dds_.{short}_", fields)
        return self.kinds[name]

    def make(self, name: str, *values: Any) -> Any:
        """A message of nested tuples."""
        made = []
        for (element, length, _), value in zip(fields_of(name), values, strict=True):
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


def until(true, seconds: float = 20.0) -> bool:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if true():
            return True
        time.sleep(0.01)
    return False


def got(reader: Any, seconds: float = 20.0) -> Any:
    """The last message that comes."""
    found: list[Any] = []
    assert until(lambda: bool(found.extend(reader.take(100)) or found), seconds)
    return found[-1]


@dataclass
class Running:
    process: subprocess.Popen[str]
    peer: Peer
    log: Path
    folder: Path


@pytest.fixture(scope="module")
def running(tmp_path_factory):
    folder = tmp_path_factory.mktemp("dds")
    domain = 20 + os.getpid() % 80
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("ROS", "CYCLONE"))}
    environment["ROS_DOMAIN_ID"] = str(domain)
    arguments = ["--ros-args", "-p", "particles:=4", "-p", "map_update_interval:=0.3", "-p", f"out:={folder / 'out'}"]
    with (folder / "node.log").open("w") as log:
        process = subprocess.Popen(
            [sys.executable, "-c", NODE, *arguments], env=environment, stderr=log, text=True, start_new_session=True
        )
    yield Running(process, Peer(domain), folder / "node.log", folder)
    if process.poll() is None:
        process.send_signal(signal.SIGINT)
        process.wait(20)


def test_scans_and_transforms_in_map_and_transform_out(running):
    peer, log = running.peer, running.log
    rng = np.random.default_rng(1)
    drive = list(
        simulate(make_world("rooms", rng), RobotConfig(), OdometryNoise(), LidarConfig(beams=90), rng).measurements
    )[:60]
    shift = time.time_ns() - drive[0].scan.stamp_ns
    scans = peer.writer("rt/scan", "sensor_msgs/LaserScan", reliable=False)
    moving = peer.writer("rt/tf", "tf2_msgs/TFMessage")
    fixed = peer.writer("rt/tf_static", "tf2_msgs/TFMessage", latched=True)
    heard, diagnostics = peer.reader("rt/tf", "tf2_msgs/TFMessage"), peer.reader(
        "rt/diagnostics", "diagnostic_msgs/DiagnosticArray"
    )
    assert until(lambda: all(writer.get_matched_subscriptions() for writer in (scans, moving, fixed))), log.read_text()
    link = mounting()
    fixed.write(transforms(peer, [link]))
    for one in drive:
        moving.write(transforms(peer, [odometry_message(one, shift)]))
        message = scan_message(one, shift)
        values = message.angle_min, 0.0, message.angle_increment, 0.0, 0.0, message.range_min, message.range_max
        header = stamp(message.stamp_ns), message.frame
        scans.write(peer.make("sensor_msgs/LaserScan", header, *values, message.ranges.tolist(), []))
        time.sleep(0.02)
    status = {}

    def accepted() -> bool:
        for message in diagnostics.take(100):
            status.update({pair.key: pair.value for pair in message.status[0].values})
        return int(status.get("accepted", 0)) >= 55  # scans are sent best effort

    assert until(accepted), (status, log.read_text())
    time.sleep(0.6)
    late = peer.reader("rt/map", "nav_msgs/OccupancyGrid", latched=True, depth=1)
    grid = got(late)
    assert (grid.header.frame_id, len(grid.data)) == ("map", grid.info.width * grid.info.height)
    assert {-1, 0, 100} == set(grid.data)
    assert got(peer.reader("rt/map_metadata", "nav_msgs/MapMetaData", latched=True)).width == grid.info.width
    links = [one for message in heard.take(100) for one in message.transforms]
    assert ("map", "odom") in {(one.header.frame_id, one.child_frame_id) for one in links}


def transforms(peer: Peer, links: list[Any]) -> Any:
    return peer.make(
        "tf2_msgs/TFMessage",
        [((stamp(at), parent), child, (pose[:3], pose[3:])) for at, parent, child, pose in links],
    )


def asked(peer: Peer, service: str, kind: str, value: Any) -> Any:
    requests = peer.writer(f"rq/{service}Request", f"{kind}_Request")
    replies = peer.reader(f"rr/{service}Reply", f"{kind}_Response")
    assert until(lambda: bool(requests.get_matched_subscriptions()) and bool(replies.get_matched_publications()))
    time.sleep(0.2)
    requests.write(peer.make(f"{kind}_Request", 42, 7, value))
    reply = got(replies)
    assert (reply.guid, reply.sequence) == (42, 7)
    return reply


def test_services_answer(running):
    peer = running.peer
    grid = asked(peer, "dynamic_map", "nav_msgs/GetMap", 0).map
    assert grid.data == got(peer.reader("rt/map", "nav_msgs/OccupancyGrid", latched=True, depth=1)).data
    assert asked(peer, "gridslam/pause", "std_srvs/SetBool", True).message == "paused"
    reply = asked(peer, "gridslam/save", "std_srvs/Trigger", 0)
    assert reply.success, reply.message
    assert (running.folder / "out" / "map.pgm").is_file()
    asked(peer, "gridslam/reset", "std_srvs/Empty", 0)
    assert until(lambda: "a new map is begun: reset" in running.log.read_text())


def test_it_lives_and_ends_well(running):
    assert running.process.poll() is None
    running.process.send_signal(signal.SIGINT)
    assert running.process.wait(20) == 0, running.log.read_text()
