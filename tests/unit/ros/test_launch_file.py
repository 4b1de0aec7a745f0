"""The launch file of ROS 2, against a stand-in for `launch`: what it starts is understood by the node."""

from __future__ import annotations

import runpy
import sys
import types
from pathlib import Path

import pytest

from gridslam.cli.commands.nodes import ros2_command
from gridslam.ros.node.parameters import node_parameters
from gridslam.ros.ros2.arguments import parse_ros_arguments

FILE = Path(__file__).resolve().parents[3] / "examples" / "ros2" / "gridslam.launch.py"


class LaunchConfiguration:
    def __init__(self, name: str) -> None:
        self.name = name


class DeclareLaunchArgument:
    def __init__(self, name: str, *, default_value: str) -> None:
        self.name, self.default_value = name, default_value


class ExecuteProcess:
    def __init__(self, *, cmd: list[object], output: str, sigterm_timeout: str) -> None:
        self.cmd, self.output, self.seconds = cmd, output, float(sigterm_timeout)


@pytest.fixture
def description(monkeypatch):
    contents = {
        "launch": {"LaunchDescription": list},
        "launch.actions": {"DeclareLaunchArgument": DeclareLaunchArgument, "ExecuteProcess": ExecuteProcess},
        "launch.substitutions": {"LaunchConfiguration": LaunchConfiguration},
    }
    for name, content in contents.items():
        module = types.ModuleType(name)
        module.__dict__.update(content)
        monkeypatch.setitem(sys.modules, name, module)
    return runpy.run_path(str(FILE))["generate_launch_description"]()


def test_what_it_starts_is_understood(description):
    *declared, process = description
    values = {argument.name: argument.default_value for argument in declared}

    def text(part: object) -> str:
        if isinstance(part, list):
            return "".join(map(text, part))
        return values[part.name] if isinstance(part, LaunchConfiguration) else str(part)

    program, command, *arguments = [text(part) for part in process.cmd]
    assert (program, command) == ("gridslam", "ros2")
    given = ros2_command.make_context("ros2", arguments).params
    ros = parse_ros_arguments(given["arguments"])
    assert ros.resolve("scan") == "/scan"
    known = {name: value for name, value in ros.parameters.items() if name != "use_sim_time"}
    assert ros.parameters["use_sim_time"] is False
    parameters = node_parameters(known, "default")
    assert parameters.warning == ""
    assert parameters.out == Path("gridslam-map")
    assert process.seconds >= 30
