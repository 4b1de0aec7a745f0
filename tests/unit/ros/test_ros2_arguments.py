"""Arguments as ROS 2 takes them."""

import importlib.util

import pytest

from gridslam.errors import ConfigurationError, InputError
from gridslam.ros.ros2.arguments import parse_ros_arguments
from gridslam.ros.ros2_rclpy.rclpy_transport import run_rclpy


def test_parameters_remappings_and_names():
    found = parse_ros_arguments(
        [
            "--ros-args",
            "-p",
            "particles:=80",
            "--param",
            "delta:=0.1",
            "-p",
            "use_sim_time:=True",
            "-p",
            "preset:=gmapping",
            "-r",
            "scan:=front/scan",
            "-r",
            "__ns:=/robot1",
            "--remap",
            "__node:=mapper",
            "-r",
            "/tf:=/tf_robot",
        ]
    )
    assert found.parameters == {"particles": 80, "delta": 0.1, "use_sim_time": True, "preset": "gmapping"}
    assert (found.node, found.namespace) == ("mapper", "/robot1")
    assert found.resolve("scan") == "/robot1/front/scan"
    assert found.resolve("map") == "/robot1/map"
    assert found.resolve("/tf") == "/tf_robot"
    assert found.resolve("/tf_static") == "/tf_static"
    assert found.resolve("~/pose") == "/robot1/mapper/pose"


@pytest.mark.parametrize(
    ("text", "value"),
    [
        (".5", 0.5),
        ("1e-3", 0.001),
        ("5.", 5.0),
        ("-2", -2),
        ("yes", True),
        ("Off", False),
        ("'30'", "30"),
        ("[1, 2]", [1, 2]),
        ("base_link", "base_link"),
        ("a=1;b=[2]", "a=1;b=[2]"),
        ("~/maps", "~/maps"),
        ("a: b", "a: b"),
        ("{", "{"),
    ],
)
def test_values_are_those_of_yaml(text, value):
    found = parse_ros_arguments(["--ros-args", "-p", f"x:={text}"]).parameters["x"]
    assert (found, type(found)) == (value, type(value))


FILE = """
/**:
  ros__parameters: {particles: 10, delta: 0.1, seed: 3}
gridslam:
  ros__parameters:
    particles: 20
    qos_overrides: {/scan: {subscription: {reliability: reliable}}}
/robot1:
  mapper:
    ros__parameters:
      particles: 40
"/*/mapper":
  ros__parameters:
    use_sim_time: yes
another:
  ros__parameters:
    seed: 5
"""


@pytest.mark.parametrize(
    ("names", "parameters"),
    [
        ([], {"particles": 20, "delta": 0.1, "seed": 3}),
        (["-r", "__node:=mapper"], {"particles": 10, "delta": 0.1, "seed": 3}),
        (
            ["-r", "__ns:=/robot1", "-r", "__node:=mapper"],
            {"particles": 40, "delta": 0.1, "seed": 3, "use_sim_time": True},
        ),
    ],
)
def test_a_file_of_parameters_tells_them_by_the_node_s_name(tmp_path, names, parameters):
    (tmp_path / "robot.yaml").write_text(FILE)
    arguments = ["--ros-args", "--params-file", str(tmp_path / "robot.yaml"), *names]
    assert parse_ros_arguments(arguments).parameters == parameters
    assert parse_ros_arguments([*arguments, "-p", "particles:=5"]).parameters["particles"] == 5
    assert parse_ros_arguments(["-p", "seed:=7", *arguments]).parameters["seed"] == 3


def test_what_only_a_ros_understands_is_ignored_and_told():
    found = parse_ros_arguments(["--ros-args", "--log-level", "debug", "--disable-rosout-logs", "-p", "seed:=1"])
    assert found.ignored == ("--log-level debug", "--disable-rosout-logs")
    assert found.parameters == {"seed": 1}


@pytest.mark.parametrize("text", ["{", "gridslam: {ros__parameters: 5}", "\t- x: ["])
def test_a_file_that_is_none_of_parameters_is_named(tmp_path, text):
    (tmp_path / "robot.yaml").write_text(text)
    with pytest.raises(InputError, match=r"robot\.yaml"):
        parse_ros_arguments(["--params-file", str(tmp_path / "robot.yaml")])
    with pytest.raises(InputError, match=r"none\.yaml"):
        parse_ros_arguments(["--params-file", str(tmp_path / "none.yaml")])


@pytest.mark.parametrize("arguments", [["particles:=3"], ["-p"], ["-p", "particles=3"], ["-r", ":=map"], ["--to", "x"]])
def test_other_arguments_are_refused(arguments):
    with pytest.raises(ConfigurationError, match="expected"):
        parse_ros_arguments(arguments)


@pytest.mark.skipif(importlib.util.find_spec("rclpy") is not None, reason="ROS 2 is here")
def test_without_ros_the_other_way_is_named():
    with pytest.raises(ConfigurationError, match=r"ROS 2 is not available .*--transport dds"):
        run_rclpy()
