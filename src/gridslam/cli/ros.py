"""gridslam ros1 and gridslam ros2."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import Any

from gridslam.cli.live import node_page
from gridslam.cli.output import end_by_signal, stop_if_interrupted
from gridslam.live.options import LiveOptions
from gridslam.ros.node.transport import RunOptions


def _make_run_options(title: str, live: LiveOptions | None, options: dict[str, Any]) -> RunOptions:
    """Return the options of the command line under the names of the node's parameters, without those not given."""
    options |= {"continue": options.pop("continued"), "set": ";".join(options.pop("assignments"))}
    given = {name: str(value) if isinstance(value, Path) else value for name, value in options.items()}
    given = {name: value for name, value in given.items() if value not in (None, "")}
    open_viewers = nullcontext if live is None else partial(node_page, live, title)
    return RunOptions(given, open_viewers, stop_if_interrupted)


@end_by_signal()
def ros1(arguments: Sequence[str], live: LiveOptions | None, **options: Any) -> None:  # noqa: ANN401
    """Run the ROS 1 node until it is stopped."""
    from gridslam.ros.ros1.ros1 import run_ros1

    run_ros1(arguments, _make_run_options("ROS 1", live, options))


@end_by_signal()
def ros2(arguments: Sequence[str], live: LiveOptions | None, **options: Any) -> None:  # noqa: ANN401
    """Run the ROS 2 node until it is stopped."""
    from gridslam.ros.ros2.rclpy_transport import run_rclpy

    run_rclpy(arguments, _make_run_options("ROS 2", live, options))
