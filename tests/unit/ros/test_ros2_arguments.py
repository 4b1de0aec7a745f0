"""Arguments as ROS 2 takes them."""

from __future__ import annotations

import pytest

from gridslam.errors import ConfigurationError
from gridslam.ros.ros2_arguments import RosArguments, parse_ros_arguments


def test_parameters_remappings_and_names():
    found = parse_ros_arguments(
        ["--ros-args", "-p", "particles:=80", "--param", "delta:=0.1", "-p", "use_sim_time:=True", "-p", "preset:=fast",
         "-r", "scan:=front/scan", "-r", "__ns:=/robot1", "--remap", "__node:=mapper", "-r", "/tf:=/tf_robot"]
    )  # fmt: skip
    assert found.parameters == {"particles": 80, "delta": 0.1, "use_sim_time": True, "preset": "fast"}
    assert (found.node, found.namespace) == ("mapper", "/robot1")
    assert found.resolve("scan") == "/robot1/front/scan"
    assert found.resolve("map") == "/robot1/map"
    assert found.resolve("/tf") == "/tf_robot"
    assert found.resolve("/tf_static") == "/tf_static"
    assert found.resolve("~/pose") == "/robot1/mapper/pose"


def test_without_arguments():
    assert parse_ros_arguments([]) == RosArguments({}, {}, "gridslam", "/")
    assert RosArguments().resolve("map") == "/map"


@pytest.mark.parametrize("arguments", [["particles:=3"], ["-p"], ["-p", "particles=3"], ["-r", ":=map"], ["--to", "x"]])
def test_other_arguments_are_refused(arguments):
    with pytest.raises(ConfigurationError, match="expected"):
        parse_ros_arguments(arguments)
