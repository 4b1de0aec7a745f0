"""The node on the wire of ROS 2: another process, with the library's own encoding, talks with it on loopback."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

cyclonedds = pytest.importorskip("cyclonedds", reason="Cyclone DDS (the extra ros2) is not installed")


from gridslam.io.sessions.session_file import read_session  # noqa: E402
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate  # noqa: E402
from support.dds_peer import Node, Peer, Robot, free_domain, got, until  # noqa: E402

PATIENT = "-p", "particles:=4", "-p", "map_update_interval:=0.3", "-p", "queue:=60.0", "-p", "transform_wait:=60.0"


@dataclass
class Running:
    node: Node
    robot: Robot
    folder: Path
    links: list[Any]

    @property
    def peer(self) -> Peer:
        return self.robot.peer


@pytest.fixture(scope="module")
def drive():
    rng = np.random.default_rng(1)
    log = simulate(make_world("rooms", rng), RobotConfig(), OdometryNoise(), LidarConfig(beams=90), rng)
    return list(log.measurements)[:60]


@pytest.fixture(scope="module")
def running(tmp_path_factory, drive):
    """A node that has mapped a drive, and in the end stops well."""
    folder, domain = tmp_path_factory.mktemp("dds"), free_domain()
    page = "--live", "--live-port", "0"
    node = Node(domain, folder / "node.log", *page, "--ros-args", *PATIENT, "-p", f"out:={folder / 'out'}")
    robot = Robot(Peer(domain))
    heard = robot.peer.reader("rt/tf", "tf2_msgs/TFMessage")
    assert robot.meets(), node.log.read_text()
    assert robot.drive(drive) >= 50, node.log.read_text()  # scans are sent best effort
    yield Running(node, robot, folder, [one for message in heard.take(1000) for one in message.transforms])
    assert node.process.poll() is None
    assert node.end() == 0, node.log.read_text()


def test_scans_and_transforms_in_map_and_transform_out(running):
    robot, peer = running.robot, running.peer
    assert robot.tells("accepted", 50), (robot.told, running.node.log.read_text())
    late = peer.reader("rt/map", "nav_msgs/OccupancyGrid", latched=True, depth=1)
    grid = got(late)
    assert (grid.header.frame_id, len(grid.data)) == ("map", grid.info.width * grid.info.height)
    assert {-1, 0, 100} == set(grid.data)
    assert got(peer.reader("rt/map_metadata", "nav_msgs/MapMetaData", latched=True)).width > 0
    assert ("map", "odom") in {(one.header.frame_id, one.child_frame_id) for one in running.links}


def asked(peer: Peer, service: str, kind: str, *values: Any) -> Any:
    requests = peer.writer(f"rq/{service}Request", f"{kind}_Request")
    replies = peer.reader(f"rr/{service}Reply", f"{kind}_Response")
    assert until(lambda: bool(requests.get_matched_subscriptions()) and bool(replies.get_matched_publications()))
    answers: list[Any] = []

    def answered() -> bool:  # the other side may have found us later than we have found it: ask until it answers
        requests.write(peer.make(f"{kind}_Request", 42, 7, *values))
        return until(lambda: bool(answers.extend(replies.take(10)) or answers), 5.0)

    assert until(answered)
    assert (answers[0].guid, answers[0].sequence) == (42, 7)
    return answers[0]


def test_services_answer(running):
    peer = running.peer

    def same_map() -> bool:
        grid = asked(peer, "dynamic_map", "nav_msgs/GetMap", 0).map
        return grid.data == got(peer.reader("rt/map", "nav_msgs/OccupancyGrid", latched=True, depth=1)).data

    assert until(same_map, 60.0)  # a newer map may come between the two
    assert asked(peer, "gridslam/pause", "std_srvs/SetBool", True).message == "paused"
    names = asked(peer, "gridslam/list_parameters", "rcl_interfaces/ListParameters", [], 0).result.names
    assert {"particles", "out", "use_sim_time"} <= set(names)
    (value,) = asked(peer, "gridslam/get_parameters", "rcl_interfaces/GetParameters", ["particles"]).values
    assert (value.type, value.integer_value) == (2, 4)
    reply = asked(peer, "gridslam/save", "std_srvs/Trigger", 0)
    assert reply.success, reply.message
    assert (running.folder / "out" / "map.pgm").is_file()
    reply = asked(peer, "gridslam/serialize_map", "std_srvs/Trigger", 0)
    assert reply.success, reply.message
    assert read_session(running.folder / "out" / "session.gridslam").run is not None
    asked(peer, "gridslam/reset", "std_srvs/Empty", 0)
    assert running.node.says("starting a new map: reset")
