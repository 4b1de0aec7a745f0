"""The node on rclpy, against a stand-in for it (tests/support/fake_rclpy.py): no ROS 2 takes part in these tests."""

from __future__ import annotations

import threading
from contextlib import contextmanager
from types import SimpleNamespace

import numpy as np
import pytest

from gridslam.errors import ConfigurationError
from gridslam.ros.node.transport import RunOptions
from gridslam.ros.ros2_rclpy.rclpy_transport import run_rclpy
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
    failed = []

    def spun():
        try:
            script()
        except BaseException as error:
            failed.append(error)
        finally:
            world.running = False

    world.spun = spun
    run_rclpy([], RunOptions(**options))
    if failed:
        raise failed[0]


def test_a_drive_by_way_of_bytes(monkeypatch, drive, tmp_path):
    world = fake_rclpy.installed(monkeypatch, {"particles": 4, "map_update_interval": 0.1, "xmin": -5.0})

    def script():
        world.subscriptions["/tf_static"][2](transforms(mounting()))
        for one in drive:
            send(world, one)
        assert until(lambda: len(world.published.get("~/pose", ())) == len(drive)), world.logged
        assert until(lambda: len(world.published.get("map", ())) >= 2)
        world.subscriptions["scan"][2](b"\0\1\0\0nonsense")
        grid = world.services["dynamic_map"](None).map
        assert len(grid.data) == grid.info.width * grid.info.height
        assert grid.header.frame_id == "map"
        saved = world.services["~/save"](None)
        assert saved.success, saved.message
        assert world.services["~/pause"](SimpleNamespace(data=True)).message == "paused"
        world.services["~/reset"](None)
        assert until(lambda: "starting a new map: reset" in str(world.logged))

    run(world, script, given={"out": str(tmp_path / "out")})
    assert (tmp_path / "out" / "map.pgm").is_file()
    assert "message refused: /scan: " in str(world.logged)
    assert "ignored parameters: xmin" in str(world.logged)
    assert world.nodes[0].destroyed


def test_ctrl_c_leaves_time_to_tell_the_last_map(monkeypatch, drive, tmp_path):
    """As rclpy's own handlers of signals would not: they shut the context down, and publishing raises from then on."""
    world = fake_rclpy.installed(monkeypatch, {"particles": 4, "map_update_interval": 60.0})

    def script():
        world.subscriptions["/tf_static"][2](transforms(mounting()))
        for one in drive:
            send(world, one)
        assert until(lambda: len(world.published.get("~/pose", ())) == len(drive)), world.logged

    played = threading.Event()

    def spun():
        if not played.is_set():
            script()
            played.set()

    def interrupted():
        if played.is_set():
            raise KeyboardInterrupt

    world.spun = spun
    run_rclpy([], RunOptions({"out": str(tmp_path / "out")}, on_poll=interrupted))
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


def test_without_ros_the_other_way_is_named():
    with pytest.raises(ConfigurationError, match=r"ROS 2 is not available .*--transport dds"):
        run_rclpy()


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


def test_of_the_parameters_only_those_can_be_set_that_are_no_settings_of_the_start(monkeypatch):
    world = fake_rclpy.installed(monkeypatch, {"particles": 4})
    results = []

    def script():
        def ask(name, kind, **value):
            given = SimpleNamespace(name=name, value=SimpleNamespace(type=kind, **value))
            results.extend(world.services["~/set_parameters"](SimpleNamespace(parameters=[given])).results)

        ask("particles", 2, integer_value=5)
        ask("anything", 2, integer_value=3)
        ask("paused_new_measurements", 1, bool_value=True)
        ask("use_sim_time", 1, bool_value=True)

    run(world, script)
    assert world.parameters["particles"] == 4
    assert world.parameters["use_sim_time"] is True
    assert [result.successful for result in results] == [False, False, True, True]
    assert "start it with -p particles:=" in results[0].reason
    assert results[1].reason == "there is no parameter anything"
