"""Map a bag: ros2 launch gridslam_ros offline_bag.launch.py bag:=drive out:=my-map; ends with the bag.

`gridslam map drive -o my-map` does the same faster, and without ROS.
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchContext, LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    EmitEvent,
    ExecuteProcess,
    IncludeLaunchDescription,
    RegisterEventHandler,
    TimerAction,
)
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.events.process import ProcessExited
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration

ARGUMENTS = {"scan": "scan", "out": "gridslam-map", "rate": "1.0", "rviz": "false"}
START_S, END_S = 3.0, 2.0  # until the node listens, and until its last scans are mapped


def end(event: ProcessExited, context: LaunchContext) -> list[TimerAction]:
    """End all when the bag has ended; an exception, as of a bag that could not be played, makes launch's status 1."""
    if event.returncode:
        raise RuntimeError(f"the bag is not played: ros2 bag play has ended with status {event.returncode}")
    return [TimerAction(period=END_S, actions=[EmitEvent(event=Shutdown(reason="the bag has ended"))])]


def generate_launch_description() -> LaunchDescription:
    """Start the node, then the bag, and end when the bag has ended."""
    share = Path(get_package_share_directory("gridslam_ros"))
    mapping = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(str(share / "launch" / "mapping.launch.py")),
        launch_arguments={
            "use_sim_time": "true",
            **{name: LaunchConfiguration(name) for name in ("scan", "out", "rviz")},
        }.items(),
    )
    command = [
        "ros2",
        "bag",
        "play",
        LaunchConfiguration("bag"),
        "--clock",
        "100",
        "--rate",
        LaunchConfiguration("rate"),
    ]
    player = ExecuteProcess(cmd=command, output="screen")
    declared = [DeclareLaunchArgument(name, default_value=value) for name, value in ARGUMENTS.items()]
    return LaunchDescription(
        [
            DeclareLaunchArgument("bag"),
            *declared,
            mapping,
            TimerAction(period=START_S, actions=[player]),
            RegisterEventHandler(OnProcessExit(target_action=player, on_exit=end)),
        ]
    )
