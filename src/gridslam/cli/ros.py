"""gridslam ros1 and gridslam ros2."""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from gridslam.cli.interrupt import stop_if_interrupted
from gridslam.errors import ConfigurationError
from gridslam.pipeline import Observer

__all__ = ["given_parameters", "ros1", "ros2"]


def given_parameters(
    preset: str | None = None, particles: int | None = None, seed: int | None = None, threads: int | None = None,
    config: Path | None = None, assignments: Sequence[str] = (), record: Path | None = None, out: Path | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Options of the command line under the names of the node's parameters; what is not given is left out."""
    options = {
        "preset": preset, "particles": particles, "seed": seed, "threads": threads,
        "config": None if config is None else str(config), "set": ";".join(assignments) or None,
        "record": None if record is None else str(record), "out": None if out is None else str(out),
    }  # fmt: skip
    return {name: value for name, value in options.items() if value is not None}


def ros1(arguments: Sequence[str], observers: Sequence[Observer] = (), **options: Any) -> None:  # noqa: ANN401
    """Be the node in ROS 1 until it is stopped."""
    from gridslam.ros.ros1 import run_ros1

    run_ros1(arguments, given=given_parameters(**options), observers=observers, tick=stop_if_interrupted)


def ros2(
    arguments: Sequence[str],
    observers: Sequence[Observer] = (),
    *,
    transport: str = "auto",
    interfaces: Sequence[str] = (),
    **options: Any,  # noqa: ANN401
) -> None:
    """Be the node in ROS 2 until it is stopped: by rclpy where a ROS 2 is sourced, else by Cyclone DDS."""
    given = given_parameters(**options)
    if transport == "dds" or (transport == "auto" and importlib.util.find_spec("rclpy") is None):
        from gridslam.ros.ros2_dds import run_dds

        run_dds(arguments, given=given, interfaces=interfaces, observers=observers, tick=stop_if_interrupted)
        return
    if interfaces:
        raise ConfigurationError("--interface: only without ROS; where there is one, its middleware decides")
    from gridslam.ros.ros2 import run_ros2

    run_ros2(arguments, given=given, observers=observers, tick=stop_if_interrupted)
