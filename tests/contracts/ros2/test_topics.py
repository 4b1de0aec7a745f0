"""Maps, transforms and scans between the node and programs of ROS 2."""

import itertools
import signal
import time

import pytest
from nav_msgs.msg import MapMetaData
from nav_msgs.srv import GetMap
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import LaserScan
from tf2_msgs.msg import TFMessage

from support.ros2_peer import BEST_EFFORT, LATCHED, SHIFT_NS, Peer, Robot, last_map, nanoseconds, values
from support.ros_node import until


@pytest.fixture
def robot(domain):
    robot = Robot(domain)
    yield robot
    robot.close()


def test_a_drive_is_mapped_scan_by_scan_and_who_comes_late_gets_the_map(start, robot, drive):
    node = start()
    assert robot.meets()
    robot.drive(drive[:200])
    assert until(lambda: len(robot.poses) >= 199), (len(robot.poses), node.log.read_text())
    assert robot.tells("accepted", 199), values(robot.status[-1])
    assert values(robot.status[-1])["dropped"] == "0"
    grid = last_map(robot)
    assert (grid.header.frame_id, len(grid.data)) == ("map", grid.info.width * grid.info.height)
    assert {-1, 0, 100} == set(grid.data)
    data = robot.hear("/map_metadata", MapMetaData, LATCHED)
    assert until(lambda: bool(data))
    assert data[-1].resolution == pytest.approx(0.05)
    served = robot.ask("/dynamic_map", GetMap).map
    assert (served.info.width, served.header.frame_id) == (data[-1].width, "map")
    stamps = robot.links_of()
    assert all(before < after for before, after in itertools.pairwise(stamps))
    assert len(stamps) >= 200


def test_nav2_s_costmap_finds_the_transform_of_each_scan_in_time(start, robot, drive):
    """Its obstacle layer waits `transform_tolerance`, 0.3 s, until a scan that has come can be placed in the map."""
    start()
    came, told = [], []
    make = robot.node.create_subscription
    make(LaserScan, "/scan", lambda scan: came.append((time.monotonic(), nanoseconds(scan.header.stamp))), BEST_EFFORT)
    make(TFMessage, "/tf", lambda message: told.append((time.monotonic(), message.transforms[0])), 1000)
    assert robot.meets()
    robot.drive(drive[:200])
    assert until(lambda: len(came) >= 200)
    until(lambda: False, 0.5)
    links = [(at_s, nanoseconds(one.header.stamp)) for at_s, one in told if one.header.frame_id == "map"]
    waits = [min(at_s for at_s, until_ns in links if until_ns >= stamp_ns) - came_s for came_s, stamp_ns in came[20:]]
    assert len(waits) == 180
    assert max(waits) < 0.3


def test_endpoints_are_those_of_a_node_of_ros(start, robot):
    """As `ros2 topic info --verbose` shows them: node, type, its hash, quality of service."""
    start()
    assert robot.meets()
    look = robot.node
    hashes = {}

    def offers(topic):
        return [one for one in look.get_publishers_info_by_topic(topic) if one.node_name == "gridslam"]

    for topic, kind in (("/map", "nav_msgs/msg/OccupancyGrid"), ("/rosout", "rcl_interfaces/msg/Log")):
        assert until(lambda topic=topic: bool(offers(topic)))
        (found,) = offers(topic)
        assert (found.topic_type, found.qos_profile.durability.name) == (kind, "TRANSIENT_LOCAL")
    for topic, kind in (("/scan", LaserScan), ("/tf", TFMessage)):
        (ours,) = (one for one in look.get_publishers_info_by_topic(topic) if one.node_name == "robot")
        (its,) = (one for one in look.get_subscriptions_info_by_topic(topic) if one.node_name == "gridslam")
        assert str(its.topic_type_hash) == str(ours.topic_type_hash), kind
        hashes[topic] = str(its.topic_type_hash)
    assert hashes["/scan"].startswith("RIHS01_")
    assert ("gridslam", "/") in look.get_node_names_and_namespaces()


def test_names_are_remapped_and_spaced(start, domain, drive):
    start("-r", "__ns:=/robot1", "-r", "scan:=/front/scan", "-r", "__node:=mapper")
    robot = Robot(domain, "/front/scan")
    try:
        assert robot.meets()
        robot.drive(drive[:30])
        assert last_map(robot, "/robot1/map").header.frame_id == "map"
        assert ("mapper", "/robot1") in robot.node.get_node_names_and_namespaces()
    finally:
        robot.close()


def test_time_may_be_simulated_and_the_map_is_stamped_by_it(start, robot, drive):
    node = start("-p", "use_sim_time:=true")
    assert robot.meets()
    robot.drive(drive[:40], clock=True)
    assert until(lambda: len(robot.poses) >= 39), node.log.read_text()
    assert "clock differs" not in node.log.read_text()
    first = drive[0].scan.stamp_ns + SHIFT_NS
    assert nanoseconds(last_map(robot).header.stamp) >= first
    assert all(stamp >= first for stamp in robot.links_of())


def test_what_does_not_fit_is_told(start, domain):
    node, peer = start(), Peer(domain)
    try:
        peer.node.create_publisher(TFMessage, "/tf", QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT))
        assert until(lambda: "reliability" in node.log.read_text().lower()), node.log.read_text()
    finally:
        peer.close()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_node_well(start, robot, drive, tmp_path, number):
    node = start(options=("-o", str(tmp_path / "out")))
    assert robot.meets()
    robot.drive(drive[:20])
    assert until(lambda: len(robot.poses) >= 19)
    assert node.end(number) == 0, node.log.read_text()
    assert (tmp_path / "out" / "map.pgm").is_file()
    assert "rror" not in node.log.read_text()


def test_who_was_killed_is_started_again(start, domain, drive):
    """First the node, then the robot: each finds the other, and the static transform that was told before."""
    first, robot = start(), Robot(domain)
    try:
        assert robot.meets()
        robot.drive(drive[:30])
        assert until(lambda: len(robot.poses) >= 29)
        first.kill()
        second = start()
        assert robot.meets()
        assert robot.stands_until_mapped(drive[29], second)  # a killed subscriber still counts
        before = len(robot.poses)
        robot.drive(drive[30:70])
        assert until(lambda: len(robot.poses) - before >= 35), second.log.read_text()
    finally:
        robot.close()
    other = Robot(domain)
    try:
        assert other.meets()
        other.drive(drive[70:110])
        assert until(lambda: len(other.poses) >= 35), second.log.read_text()
    finally:
        other.close()
