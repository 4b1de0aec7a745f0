"""The packages for ROS: what their files start, set and show is understood by the node."""

import json
import re
import runpy
import sys
import types
from types import SimpleNamespace

import pytest

from gridslam.io.maps import write_map
from gridslam.io.ros_parameters import read_parameter_file
from gridslam.io.yaml import parse_yaml
from gridslam.ros.node.parameters import node_parameters
from gridslam.ros.node.transport import ALL_TOPICS
from support.house import ROOT
from support.localization_world import flat_map

PACKAGE = ROOT / "ros" / "gridslam_ros"
TAKEN = {"/scan", "/initialpose", "/tf", "/clock"}
PUBLISHED = {("/" + name.removeprefix("/")).replace("/~", "/gridslam") for name in ALL_TOPICS}


class LaunchConfiguration(SimpleNamespace):
    def __init__(self, name):
        super().__init__(name=name)


def kept(kind):
    return lambda *values, **named: SimpleNamespace(kind=kind, values=values, **named)


@pytest.fixture
def launched(monkeypatch):
    """The function that runs a launch file with stand-ins for what it imports."""
    contents = {
        "ament_index_python.packages": {"get_package_share_directory": lambda name: str(PACKAGE)},
        "launch": {"LaunchDescription": list, "LaunchContext": SimpleNamespace},
        "launch.actions": {
            name: kept(name)
            for name in (
                "DeclareLaunchArgument",
                "EmitEvent",
                "ExecuteProcess",
                "IncludeLaunchDescription",
                "RegisterEventHandler",
                "TimerAction",
            )
        },
        "launch.conditions": {"IfCondition": kept("IfCondition")},
        "launch.event_handlers": {"OnProcessExit": kept("OnProcessExit")},
        "launch.events": {"Shutdown": kept("Shutdown")},
        "launch.events.process": {"ProcessExited": SimpleNamespace},
        "launch.launch_description_sources": {"PythonLaunchDescriptionSource": kept("source")},
        "launch.substitutions": {
            "LaunchConfiguration": LaunchConfiguration,
            "PythonExpression": lambda parts: SimpleNamespace(parts=parts),
        },
        "launch_ros.actions": {"Node": kept("Node")},
        "launch_ros.parameter_descriptions": {
            "ParameterValue": lambda value, value_type: SimpleNamespace(value=value, type=value_type)
        },
    }
    for name, content in contents.items():
        module = types.ModuleType(name)
        module.__dict__.update(content)
        monkeypatch.setitem(sys.modules, name, module)
        monkeypatch.setitem(sys.modules, name.partition(".")[0], sys.modules.get(name.partition(".")[0], module))
    return lambda name: runpy.run_path(str(PACKAGE / "launch" / name))["generate_launch_description"]()


def found(actions, kind):
    return [action for action in actions if action.kind == kind]


@pytest.mark.parametrize("name", ["mapping", "localization"])
def test_a_launch_file_starts_the_node_with_its_file_of_parameters(launched, name, tmp_path):
    actions = launched(f"{name}.launch.py")
    defaults = {action.values[0]: action.default_value for action in found(actions, "DeclareLaunchArgument")}
    node, rviz = found(actions, "Node")
    assert (node.package, node.executable, node.name) == ("gridslam_ros", "node", "gridslam")
    assert rviz.arguments == ["-d", str(PACKAGE / "rviz" / "gridslam.rviz")]
    ((_, parameters),) = read_parameter_file(defaults["params_file"])
    file, given = node.parameters
    assert file.name == "params_file"
    write_map(tmp_path / "flat.yaml", flat_map())
    values = {**defaults, "map": str(tmp_path / "flat.yaml")}
    for parameter, value in given.items():
        if parameter == "use_sim_time":
            assert value.type is bool
        elif isinstance(value.value, LaunchConfiguration):
            parameters[parameter] = values[value.value.name]
    assert {argument for _, argument in ((of, to.name) for of, to in node.remappings)} <= set(defaults)
    understood = node_parameters(parameters, "default")
    assert understood.warning == ""
    assert (understood.configuration.__class__.__name__ == "Localization") == (name == "localization")


def test_a_bag_is_played_and_its_end_ends_all(launched):
    actions = launched("offline_bag.launch.py")
    declared = {action.values[0] for action in found(actions, "DeclareLaunchArgument")}
    assert declared == {"bag", "scan", "out", "rate", "rviz"}
    (include,) = found(actions, "IncludeLaunchDescription")
    arguments = dict(include.launch_arguments)
    assert arguments["use_sim_time"] == "true"
    of_mapping = {action.values[0] for action in found(launched("mapping.launch.py"), "DeclareLaunchArgument")}
    assert set(arguments) <= of_mapping
    (timer,) = found(actions, "TimerAction")
    (player,) = timer.actions
    assert player.cmd[:3] == ["ros2", "bag", "play"]
    assert "--clock" in player.cmd
    (handler,) = found(actions, "RegisterEventHandler")
    assert handler.values[0].target_action is player
    (timer,) = handler.values[0].on_exit(SimpleNamespace(returncode=0), None)
    assert timer.actions[0].event.reason == "the bag has ended"
    with pytest.raises(RuntimeError, match="ros2 bag play has ended with status 1"):
        handler.values[0].on_exit(SimpleNamespace(returncode=1), None)


def test_the_layouts_show_topics_of_the_node():
    rviz = (PACKAGE / "rviz" / "gridslam.rviz").read_text(encoding="utf-8")
    layout = parse_yaml(rviz)["Visualization Manager"]
    topics = set(re.findall(r"Value: (/[\w/]+)", rviz))
    assert {"/map", "/scan", "/particlecloud", "/gridslam/pose", "/initialpose"} == topics
    assert topics <= PUBLISHED | TAKEN
    assert layout["Global Options"]["Fixed Frame"] == "map"
    latched = next(display for display in layout["Displays"] if display["Name"] == "Map")
    assert latched["Topic"]["Durability Policy"] == "Transient Local"
    scan = next(display for display in layout["Displays"] if display["Name"] == "Scan")
    assert scan["Topic"]["Reliability Policy"] == "Best Effort"
    foxglove = json.loads((PACKAGE / "foxglove" / "gridslam.json").read_text(encoding="utf-8"))
    panels = foxglove["configById"]
    assert set(panels["3D!map"]["topics"]) <= PUBLISHED | TAKEN
    assert set(re.findall(r'"(\w+!\w+)"', json.dumps(foxglove["layout"]))) == set(panels)


def test_the_package_installs_all_its_files(monkeypatch):
    calls = []
    monkeypatch.chdir(PACKAGE)
    monkeypatch.setattr("setuptools.setup", lambda **options: calls.append(options))
    runpy.run_path("setup.py")
    installed = {file for _, files in calls[0]["data_files"] for file in files}
    there = {str(path.relative_to(PACKAGE)) for path in PACKAGE.rglob("*") if path.is_file()}
    sources = {"setup.py", "setup.cfg", "gridslam_ros/__init__.py", "gridslam_ros/node.py"}
    assert installed == {name for name in there if "__pycache__" not in name} - sources
    assert (PACKAGE / "gridslam_ros" / "node.py").is_file()
    assert calls[0]["entry_points"]["console_scripts"] == ["node = gridslam_ros.node:main"]
