"""ros2 launch examples/ros2/gridslam.launch.py scan:=/front/scan base_frame:=base_footprint."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess
from launch.substitutions import LaunchConfiguration

PARAMETERS = {
    "base_frame": "base_link",
    "odom_frame": "odom",
    "particles": "30",
    "preset": "default",
    "use_sim_time": "false",
    "out": "gridslam-map",
}


def generate_launch_description() -> LaunchDescription:
    """Start the node, with its parameters as arguments of the launch file."""
    values = [["-p", [f"{name}:=", LaunchConfiguration(name)]] for name in PARAMETERS]
    command = ["gridslam", "ros2", "--ros-args", "-r", ["scan:=", LaunchConfiguration("scan")]]
    command += [part for pair in values for part in pair]
    arguments = [DeclareLaunchArgument(name, default_value=value) for name, value in PARAMETERS.items()]
    arguments.append(DeclareLaunchArgument("scan", default_value="scan"))
    return LaunchDescription([*arguments, ExecuteProcess(cmd=command, output="screen", sigterm_timeout="60")])
