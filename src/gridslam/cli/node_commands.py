"""The commands that are nodes, and their options."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import click

from gridslam.cli.live import live_options
from gridslam.cli.options import PATH, SEED, SETTINGS
from gridslam.cli.rerun import rerun_option

__all__ = ["NODE_COMMANDS"]

_NODE = (
    click.argument("arguments", nargs=-1, type=click.UNPROCESSED),
    click.option("--preset", help="Preset: default, fast, accurate or gmapping."),
    click.option("--particles", type=int, help="Number of particles."),
    click.option("--seed", type=SEED, help="Random seed; equal seeds and scans give equal results."),
    click.option("--threads", type=click.IntRange(1, 256), help="Number of threads; does not affect the results."),
    click.option("--config", type=PATH, help="TOML file with parameters; overrides the preset."),
    click.option("--set", "assignments", multiple=True, metavar="NAME=VALUE", help="Set one parameter (see map)."),
    click.option("--map", "map_file", type=PATH, help="Map YAML file; localize in this map instead of mapping."),
    click.option("-o", "--out", type=PATH, help="Output folder of the node."),
    click.option("--record", type=PATH, metavar="FILE", help="Record the accepted scans to FILE for offline mapping."),
)
_NODE_SETTINGS = {**SETTINGS, "ignore_unknown_options": True}


def _node_options(command: Callable[..., Any]) -> Callable[..., Any]:
    command = live_options(rerun_option(command))
    for option in reversed(_NODE):
        command = option(command)
    return command


@click.command("ros1", context_settings=_NODE_SETTINGS)
@_node_options
def ros1_command(**options: Any) -> None:  # noqa: ANN401
    """Run the ROS 1 node, a drop-in replacement for slam_gmapping: subscribes to /scan and /tf, publishes /map.

    ARGUMENTS are ROS arguments: _name:=value sets a parameter, name:=other remaps a topic.
    """
    from gridslam.cli.ros import ros1

    ros1(**options)


@click.command("ros2", context_settings=_NODE_SETTINGS)
@_node_options
@click.option(
    "--transport", type=click.Choice(["auto", "rclpy", "dds"]), default="auto", show_default=True,
    help="rclpy of a sourced ROS 2, or Cyclone DDS without ROS (extra: ros2).",
)  # fmt: skip
@click.option("--interface", "interfaces", multiple=True, help="Network interface of DDS; repeatable.")
def ros2_command(**options: Any) -> None:  # noqa: ANN401
    """Run the ROS 2 node: subscribes to /scan and /tf, publishes /map.

    ARGUMENTS are ROS arguments after --ros-args.
    """
    from gridslam.cli.ros import ros2

    ros2(**options)


NODE_COMMANDS = (ros1_command, ros2_command)
