"""What comes as bytes is a scan, or is named; nothing ends the node."""

import importlib.util
import subprocess
import sys

import numpy as np
import pytest

from gridslam.errors import GridslamError
from gridslam.io.maps import write_map
from gridslam.ros.node.parameters import node_parameters
from gridslam.ros.node.ros_node import RosNode
from support.localization_world import flat_map
from support.ros_bytes import ENCODER, encode_message
from support.ros_node import LocalTransport

STAMP = 1_700_000_000, 5


def scan(beams):
    values = STAMP, "laser"
    empty = encode_message("sensor_msgs/LaserScan", (values, -1.0, 1.0, 2e-8, 0.0, 0.0, 0.1, 30.0, [], []))
    return empty[:-8] + beams.to_bytes(4, "little") + np.ones(beams, "<f4").tobytes() + bytes(4)


def test_bytes_that_are_no_scan_are_named_and_the_node_lives():
    transport = LocalTransport()
    node = RosNode(transport, node_parameters({}, "default"))
    node.start()
    take = transport.handlers
    try:
        take["scan"](scan(26_214_400))
        take["scan"](b"\0\1\0\0nonsense")
        take["scan"](b"")
        take["scan"](encode_message("std_msgs/Float64", (1.0,)))
        take["/tf"](b"\0\1\0\0\xff\xff\xff\xff")
        values = node.core.diagnostics().values
        assert values["refused"] == "1"
        assert values["message refused, times"] == "4"
        refused = "scan refused: /scan: 26214400 beams, more than the maximum of 100000"
        assert refused in transport.outputs.warnings()
        assert not node.core.ended.is_set()
    finally:
        node.close()
    assert node.core.failure is None


def test_dynamic_map_answers_the_bytes_of_the_map_that_was_published(tmp_path):
    transport = LocalTransport()
    write_map(tmp_path / "flat.yaml", flat_map())
    node = RosNode(transport, node_parameters({"map_file": str(tmp_path / "flat.yaml")}, "default"))
    node.start()
    try:
        (published,) = transport.outputs.maps
        served = ENCODER.decode("nav_msgs/OccupancyGrid", transport.services["dynamic_map"](None))
        assert served.data.tolist() == published.cells.ravel().tolist()
        assert (served.info.height, served.info.width) == published.cells.shape
    finally:
        node.close()


def test_without_a_map_dynamic_map_is_refused():
    transport = LocalTransport()
    node = RosNode(transport, node_parameters({}, "default"))
    node.start()
    try:
        with pytest.raises(GridslamError, match="there is no map yet"):
            transport.services["dynamic_map"](None)
    finally:
        node.close()


@pytest.mark.skipif(importlib.util.find_spec("rclpy") is not None, reason="ROS 2 is here")
def test_without_ros_2_one_line_names_what_is_missing():
    run = subprocess.run([sys.executable, "-m", "gridslam", "ros2"], capture_output=True, text=True)
    assert (run.returncode, run.stdout) == (2, "")
    (line,) = run.stderr.splitlines()
    assert "rclpy of ROS 2 is not available" in line
    assert "source a ROS 2" in line
    assert "--system-site-packages" in line
