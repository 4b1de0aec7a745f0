"""Localize in a known map: ros2 launch gridslam_ros localization.launch.py map:=my-map/map.yaml."""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

ARGUMENTS = {
    "params_file": "",  # the package's own; set below
    "map": "",
    "scan": "scan",
    "use_sim_time": "false",
    "namespace": "",
    "rviz": "false",
}


def generate_launch_description() -> LaunchDescription:
    """Start the node, and RViz if that is asked for."""
    share = Path(get_package_share_directory("gridslam_ros"))
    defaults = {**ARGUMENTS, "params_file": str(share / "config" / "localization.yaml")}
    given = {
        "use_sim_time": ParameterValue(LaunchConfiguration("use_sim_time"), value_type=bool),
        "map_file": ParameterValue(LaunchConfiguration("map"), value_type=str),
    }
    node = Node(
        package="gridslam_ros",
        executable="node",
        name="gridslam",
        namespace=LaunchConfiguration("namespace"),
        parameters=[LaunchConfiguration("params_file"), given],
        remappings=[("scan", LaunchConfiguration("scan"))],
        output="screen",
    )
    rviz = Node(
        package="rviz2",
        executable="rviz2",
        arguments=["-d", str(share / "rviz" / "gridslam.rviz")],
        parameters=[{"use_sim_time": given["use_sim_time"]}],
        condition=IfCondition(LaunchConfiguration("rviz")),
    )
    declared = [DeclareLaunchArgument(name, default_value=value) for name, value in defaults.items()]
    return LaunchDescription([*declared, node, rviz])
