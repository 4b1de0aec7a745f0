"""The node on the wire of ROS 2: another process, with the library's own encoding, talks with it on loopback."""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

cyclonedds = pytest.importorskip("cyclonedds", reason="Cyclone DDS (the extra ros2) is not installed")

from websockets.sync.client import connect  # noqa: E402

from gridslam.io.maps import write_map  # noqa: E402
from gridslam.io.sessions.session_file import read_session  # noqa: E402
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate  # noqa: E402
from support.dds_peer import Node, Peer, Robot, free_domain, got, transforms, until  # noqa: E402
from support.localization_world import drive as flat_drive  # noqa: E402
from support.localization_world import flat_map  # noqa: E402
from support.page_client import PageClient  # noqa: E402
from support.ros_node import mounting, odometry_message, scan_message  # noqa: E402

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


def test_its_page_shows_the_map(running):
    assert running.node.says("live at http://127.0.0.1:")
    url = running.node.log.read_text().split("live at ")[1].split()[0]
    client = PageClient()
    with connect(url.replace("http", "ws", 1) + "socket", max_size=None) as line:

        def seen():
            client.receive(line.recv(60))
            line.send(json.dumps({"do": "ack"}))
            return len(client.tiles) > 10 and client.status["scans"] >= 50

        assert until(seen), client.status
    assert (client.run_info["mode"], client.run_info["title"]) == ("robot", "ROS 2")
    assert client.status["stage"] == "running"


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
    reply = asked(peer, "gridslam/localize", "std_srvs/SetBool", True)
    assert reply.message == "localizing in the map so far"
    reply = asked(peer, "gridslam/localize", "std_srvs/SetBool", False)
    assert reply.message in (
        "mapping goes on",
        "localize: expected a robot that knows where it is, got one that is lost",
    )
    asked(peer, "gridslam/reset", "std_srvs/Empty", 0)
    assert running.node.says("starting a new map: reset")


def test_a_node_that_was_killed_is_started_again(drive, tmp_path):
    """The robot goes on all the time: what it latched reaches the second node, and whoever waited for its map."""
    domain = free_domain()
    robot = Robot(Peer(domain))
    waiting = robot.peer.reader("rt/map", "nav_msgs/OccupancyGrid", latched=True, depth=1)
    first = Node(domain, tmp_path / "first.log", "--ros-args", *PATIENT)
    second = None
    try:
        assert robot.meets(), first.log.read_text()
        assert robot.drive(drive[:30]) >= 20, first.log.read_text()
        assert got(waiting).header.frame_id == "map"
        first.kill()
        second = Node(domain, tmp_path / "second.log", "--ros-args", *PATIENT)
        assert robot.meets(), second.log.read_text()
        assert robot.drive(drive[30:]) >= 20, second.log.read_text()
        assert got(waiting).header.frame_id == "map"
        assert robot.tells("accepted", 20)
        assert robot.told["session"] == "1"
        assert second.end() == 0
    finally:
        for node in filter(None, (first, second)):
            node.kill()


@pytest.mark.parametrize("times", [pytest.param(20, marks=pytest.mark.long), 2])
def test_a_node_maps_at_once_though_the_static_transform_is_old(drive, tmp_path, times, record_property):
    """Within a second from its start to `mapping`, beside a robot that has stood there for long."""
    domain = free_domain()
    robot = Robot(Peer(domain))
    robot.fixed.write(transforms(robot.peer, [mounting()]))
    took = []
    for _ in range(times):
        node = Node(domain, tmp_path / "node.log", "--ros-args", "-p", "particles:=4")
        try:
            assert node.says("waiting for scans"), node.log.read_text()
            begin = time.monotonic()
            while not node.says("mapping", seconds=0.0):
                assert time.monotonic() < begin + 20
                shift = time.time_ns() - drive[0].scan.stamp_ns
                robot.moving.write(transforms(robot.peer, [odometry_message(drive[0], shift)]))
                robot.send(scan_message(drive[0], shift))
                time.sleep(0.025)
            took.append(time.monotonic() - begin)
            assert node.end() == 0
        finally:
            node.kill()
    record_property("from its start to `mapping`, s", [round(one, 2) for one in took])
    assert max(took) < 1.0, took


def test_the_session_of_a_node_that_was_killed_goes_on(drive, tmp_path):
    """From the autosave, by the options of the command: as one drive, in one file."""
    domain = free_domain()
    robot = Robot(Peer(domain))
    out, save = tmp_path / "out", tmp_path / "floor.gridslam"
    autosave = out / "autosave.gridslam"
    first = Node(domain, tmp_path / "1.log", "-o", str(out), "--autosave", "0.005", "--ros-args", *PATIENT)
    second = None
    try:
        assert robot.meets(), first.log.read_text()
        mapped = robot.drive(drive[:30])
        assert mapped >= 20, first.log.read_text()
        assert until(lambda: autosave.exists() and len(read_session(autosave).run.trajectory.keys) >= mapped)
        first.kill()
        left = len(read_session(autosave).run.trajectory.keys)
        options = "-o", str(out), "--continue", str(autosave), "--save", str(save), "--same-place"
        second = Node(domain, tmp_path / "2.log", *options, "--ros-args", *PATIENT)
        assert robot.meets(), second.log.read_text()
        more = robot.drive(drive[30:])
        assert more >= 20, second.log.read_text()
        assert second.says(f"session {autosave}: goes on where it has ended")
        assert second.end() == 0, second.log.read_text()
        saved = read_session(save)
        assert len([*saved.drives]) == 1
        assert abs(len(saved.run.trajectory.keys) - left - more) <= 2
        assert not autosave.exists()
        lines = (out / "trajectory.tum").read_text().splitlines()
        assert len(lines) == len(saved.run.trajectory.keys)
    finally:
        for node in filter(None, (first, second)):
            node.kill()


def test_a_robot_is_localized_in_a_known_map(tmp_path):
    write_map(tmp_path / "flat.yaml", flat_map())
    log = flat_drive(3)
    domain = free_domain()
    robot = Robot(Peer(domain))
    peer = robot.peer
    poses = peer.writer("rt/initialpose", "geometry_msgs/PoseWithCovarianceStamped")
    clouds = peer.reader("rt/particlecloud", "geometry_msgs/PoseArray")
    heard = peer.reader("rt/gridslam/pose", "geometry_msgs/PoseWithCovarianceStamped")
    node = Node(domain, tmp_path / "node.log", "--map", str(tmp_path / "flat.yaml"), "--ros-args", *PATIENT[2:])
    try:
        assert robot.meets(), node.log.read_text()
        assert until(lambda: bool(poses.get_matched_subscriptions()))
        assert got(peer.reader("rt/map", "nav_msgs/OccupancyGrid", latched=True, depth=1)).header.frame_id == "map"
        x, y, theta = log.truth.poses[0].tolist()
        turn = 0.0, 0.0, float(np.sin(theta / 2)), float(np.cos(theta / 2))
        for frame in ("odom", "map"):
            covariance = np.diag([0.04, 0.04, 0.0, 0.0, 0.0, 0.03]).ravel().tolist()
            header = ((0, 0), frame), (((x, y, 0.0), turn), covariance)
            poses.write(peer.make("geometry_msgs/PoseWithCovarianceStamped", *header))
            assert frame == "map" or node.says("expected a pose in the frame map, got 'odom'")
        assert robot.drive(log.measurements[:45]) >= 40, node.log.read_text()
        told = got(heard).pose.pose.position
        assert np.hypot(told.x - log.truth.poses[44, 0], told.y - log.truth.poses[44, 1]) < 0.5
        assert len(got(clouds).poses) >= 100
        asked(peer, "reinitialize_global_localization", "std_srvs/Empty", 0)
        assert node.end() == 0, node.log.read_text()
    finally:
        node.kill()
