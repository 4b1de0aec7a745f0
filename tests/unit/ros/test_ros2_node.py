"""The node on rclpy, against a stand-in for it (tests/support/fake_rclpy.py): no ROS 2 takes part in these tests."""

from __future__ import annotations

import sys
from contextlib import contextmanager
from types import SimpleNamespace

import numpy as np
import pytest

from gridslam.errors import ConfigurationError
from gridslam.io.sessions.session_file import read_session
from gridslam.ros.ros2.ros2 import run_ros2
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate
from support import fake_rclpy
from support.ros_bytes import encode_message
from support.ros_node import mounting, odometry_message, scan_message, until

SHIFT_NS = 1_700_000_000 * 10**9


@pytest.fixture(scope="module")
def drive():
    rng = np.random.default_rng(1)
    log = simulate(make_world("rooms", rng), RobotConfig(), OdometryNoise(), LidarConfig(beams=90), rng)
    return list(log.measurements)[:40]


def header(stamp_ns, frame):
    return divmod(stamp_ns, 10**9), frame


def transforms(link):
    values = [(header(link.stamp_ns, link.parent), link.child, (link.pose[:3], link.pose[3:]))]
    return encode_message("tf2_msgs/TFMessage", (values,))


def send(world, measurement):
    message = scan_message(measurement, SHIFT_NS)
    world.clock_ns = message.stamp_ns
    world.subscriptions["/tf"][2](transforms(odometry_message(measurement, SHIFT_NS)))
    values = message.angle_min, 0.0, message.angle_increment, 0.0, 0.0, message.range_min, message.range_max
    scan = header(message.stamp_ns, message.frame), *values, message.ranges.tolist(), []
    world.subscriptions["scan"][2](encode_message("sensor_msgs/LaserScan", scan))


def run(world, script, **options):
    """Run the node, whose executor runs the script once."""

    def spun():
        try:
            script()
        finally:
            world.running = False

    world.spun = spun
    run_ros2([], **options)


def test_a_drive_by_way_of_bytes(monkeypatch, drive, tmp_path):
    world = fake_rclpy.installed(monkeypatch, {"particles": 4, "map_update_interval": 0.1, "xmin": -5.0})

    def script():
        world.subscriptions["/tf_static"][2](transforms(mounting()))
        for one in drive:
            send(world, one)
        assert until(lambda: len(world.published.get("~/pose", ())) == len(drive)), world.logged
        assert until(lambda: len(world.published.get("map", ())) >= 2)
        world.subscriptions["scan"][2](b"\0\1\0\0nonsense")
        grid = SimpleNamespace(
            header=SimpleNamespace(stamp=SimpleNamespace()),
            info=SimpleNamespace(
                map_load_time=SimpleNamespace(),
                origin=SimpleNamespace(position=SimpleNamespace(), orientation=SimpleNamespace()),
            ),
        )
        response = world.services["dynamic_map"](None, SimpleNamespace(map=grid)).map
        assert len(response.data) == response.info.width * response.info.height
        assert response.header.frame_id == "map"
        saved = world.services["~/save"](None, SimpleNamespace())
        assert saved.success, saved.message
        assert world.services["~/pause"](SimpleNamespace(data=True), SimpleNamespace()).message == "paused"
        world.services["~/reset"](None, SimpleNamespace())
        assert until(lambda: "starting a new map: reset" in str(world.logged))

    run(world, script, given={"out": str(tmp_path / "out")})
    assert (tmp_path / "out" / "map.pgm").is_file()
    assert "message refused: /scan: " in str(world.logged)
    assert "ignored parameters: xmin" in str(world.logged)
    assert world.nodes[0].destroyed


def test_services_of_slam_toolbox_by_its_own_names_and_types(monkeypatch, drive, tmp_path):
    world = fake_rclpy.installed(monkeypatch, {"particles": 4}, slam_toolbox=True)
    path = tmp_path / "floor.gridslam"

    def script():
        world.subscriptions["/tf_static"][2](transforms(mounting()))
        for one in drive:
            send(world, one)
        assert until(lambda: len(world.published.get("~/pose", ())) == len(drive)), world.logged
        request = SimpleNamespace(filename=str(tmp_path / "floor"))
        assert world.services["slam_toolbox/serialize_map"](request, SimpleNamespace(result=9)).result == 0
        old = world.services["slam_toolbox/serialize_map"](request, SimpleNamespace())  # up to Foxy without a result
        assert vars(old) == {}
        pause = world.services["slam_toolbox/pause_new_measurements"]
        assert pause(SimpleNamespace(), SimpleNamespace(status=False)).status
        assert world.services["slam_toolbox/clear_changes"](SimpleNamespace(), SimpleNamespace()) is not None
        assert {"~/serialize_map", "~/reset"} <= set(world.services)  # the node has another name

    run(world, script)
    assert len(read_session(path).run.trajectory.keys) == len(drive)
    other = fake_rclpy.installed(monkeypatch, {"particles": 4})
    monkeypatch.delitem(sys.modules, "slam_toolbox.srv", raising=False)
    run(other, lambda: None)
    assert not any(name.startswith("slam_toolbox/") for name in other.services)
    assert "~/serialize_map" in other.services


def test_ctrl_c_leaves_time_to_tell_the_last_map(monkeypatch, drive, tmp_path):
    """As rclpy's own handlers of signals would not: they shut the context down, and publishing raises from then on."""
    world = fake_rclpy.installed(monkeypatch, {"particles": 4, "map_update_interval": 60.0})

    def script():
        world.subscriptions["/tf_static"][2](transforms(mounting()))
        for one in drive:
            send(world, one)
        assert until(lambda: len(world.published.get("~/pose", ())) == len(drive)), world.logged

    def interrupted():
        raise KeyboardInterrupt

    world.spun = script
    run_ros2([], given={"out": str(tmp_path / "out")}, on_poll=interrupted)
    assert world.signals == "NO"
    assert (tmp_path / "out" / "map.pgm").is_file()
    assert f"writing 40 scans to {tmp_path / 'out'}" in world.logged[-1][1]


def test_a_context_that_others_shut_down_ends_the_node_well(monkeypatch, drive, tmp_path):
    """What the filter still says on its way out is not published, and that is no failure."""
    world, cores = fake_rclpy.installed(monkeypatch, {"particles": 4}), []

    @contextmanager
    def open_viewers(core):
        cores.append(core)
        yield

    def script():
        world.subscriptions["/tf_static"][2](transforms(mounting()))
        send(world, drive[0])
        assert until(lambda: len(world.published.get("~/pose", ())) == 1), world.logged
        world.running = False
        send(world, drive[1])
        assert until(lambda: cores[0].diagnostics().values["accepted"] == "2")

    run(world, script, given={"out": str(tmp_path / "out")}, open_viewers=open_viewers)
    assert (tmp_path / "out" / "map.pgm").is_file()


def test_quality_of_service(monkeypatch):
    world = fake_rclpy.installed(monkeypatch, {})

    def told(profile):
        return profile.reliability.name, profile.durability.name, profile.depth

    run(world, lambda: None)
    assert told(world.publishers["map"][1]) == ("RELIABLE", "TRANSIENT_LOCAL", 1)
    assert told(world.publishers["map_metadata"][1]) == ("RELIABLE", "TRANSIENT_LOCAL", 1)
    assert told(world.publishers["/tf"][1]) == ("RELIABLE", "VOLATILE", 10)
    assert told(world.subscriptions["scan"][1]) == ("BEST_EFFORT", "VOLATILE", 10)
    assert told(world.subscriptions["/tf_static"][1]) == ("RELIABLE", "TRANSIENT_LOCAL", 100)


def test_a_managed_node_maps_while_it_is_active(monkeypatch, drive):
    world = fake_rclpy.installed(monkeypatch, {"lifecycle": True, "particles": 4})

    def script():
        node = world.nodes[-1]
        world.subscriptions["/tf_static"][2](transforms(mounting()))
        node.on_configure(None)
        send(world, drive[0])
        assert node.core.diagnostics().values["paused"] == "1"
        node.on_activate(None)
        send(world, drive[1])
        assert until(lambda: len(world.published.get("~/pose", ())) == 1)
        node.on_deactivate(None)
        send(world, drive[2])
        assert node.core.diagnostics().values["paused"] == "2"
        node.on_cleanup(None)
        assert until(lambda: "starting a new map: reset" in str(world.logged))
        node.on_activate(None)
        node.on_shutdown(None)
        send(world, drive[3])
        assert node.core.diagnostics().values["paused"] == "3"

    run(world, script)
    assert world.nodes[0].destroyed


def test_what_ros_would_not_understand_is_refused(monkeypatch):
    fake_rclpy.installed(monkeypatch, {})
    with pytest.raises(ConfigurationError, match="after --ros-args, got --particle 3"):
        run_ros2(["--particle", "3", "--ros-args", "-p", "seed:=1"])


def test_without_ros_the_other_way_is_named():
    with pytest.raises(ConfigurationError, match=r"ROS 2 is not available .*--transport dds"):
        run_ros2()


def scan_bytes(measurement, **changes):
    message = scan_message(measurement, SHIFT_NS, **changes)
    values = message.angle_min, 0.0, message.angle_increment, 0.0, 0.0, message.range_min, message.range_max
    empty = encode_message("sensor_msgs/LaserScan", (header(message.stamp_ns, message.frame), *values, [], []))
    count = len(message.ranges).to_bytes(4, "little")
    return empty[:-8] + count + message.ranges.astype("<f4").tobytes() + bytes(4)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"ranges": np.ones(3, np.float32)}, "scan refused: /scan: 3 beams are too few"),
        (
            {"ranges": np.ones(26_214_400, np.float32)},
            "scan refused: /scan: 26214400 beams, more than the maximum of 100000",
        ),
        ({"stamp_ns": 0}, "scan refused: /scan: expected a stamp of more than 0 s"),
        ({"frame": ""}, "scan refused: /scan: expected the name of a frame"),
        ({"angle_min": float("nan")}, "message refused: /scan: its angles are from nan"),
    ],
)
def test_what_is_no_scan_is_named_and_the_next_one_is_taken(monkeypatch, drive, change, says):
    world = fake_rclpy.installed(monkeypatch, {"particles": 3})

    def script():
        world.subscriptions["/tf_static"][2](transforms(mounting()))
        world.subscriptions["scan"][2](scan_bytes(drive[0], **change))
        send(world, drive[1])
        assert until(lambda: len(world.published.get("~/pose", ())) == 1), world.logged

    run(world, script)
    assert says in str(world.logged)


def test_parameters_are_declared_and_what_is_read_at_the_start_cannot_be_set(monkeypatch):
    world = fake_rclpy.installed(monkeypatch, {"particles": 4})
    results = []

    def script():
        node = world.nodes[-1]

        def ask(name, value):
            results.append(world.on_set([SimpleNamespace(name=name, value=value)]))

        ask("particles", 5)
        ask("paused_new_measurements", True)
        ask("use_sim_time", True)
        results.append(node)

    run(world, script)
    assert world.parameters["particles"] == 4
    assert world.parameters["map_update_interval"] == 5.0
    refused, paused, other, _ = results
    assert (refused.successful, "start it with -p particles:=" in refused.reason) == (False, True)
    assert paused.successful
    assert other.successful
