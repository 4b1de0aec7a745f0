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
    click.option("--preset", help="default, fast, accurate or gmapping."),
    click.option("--particles", type=int, help="Number of particles."),
    click.option("--seed", type=SEED, help="The same seed and scans give the same bytes."),
    click.option("--threads", type=click.IntRange(1, 256), help="Never changes a result."),
    click.option("--config", type=PATH, help="TOML file with parameters, over the preset's."),
    click.option("--set", "assignments", multiple=True, metavar="NAME=VALUE", help="Set one parameter (see map)."),
    click.option("--map", "map_file", type=PATH, help="Localize the robot in this map, instead of making one."),
    click.option("-o", "--out", type=PATH, help="Folder that the node saves its results in."),
    click.option("--record", type=PATH, metavar="FILE", help="Keep the accepted scans, to be mapped again."),
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
    """Be a node in ROS 1, in the place of slam_gmapping: /scan and /tf in, /map out.

    ARGUMENTS are ROS's own: _name:=value for a parameter, name:=other to remap a topic.
    """
    from gridslam.cli.ros import ros1

    ros1(**options)


@click.command("ros2", context_settings=_NODE_SETTINGS)
@_node_options
@click.option(
    "--transport", type=click.Choice(["auto", "rclpy", "dds"]), default="auto", show_default=True,
    help="rclpy of a sourced ROS 2, or Cyclone DDS, which needs no ROS (extra: ros2).",
)  # fmt: skip
@click.option("--interface", "interfaces", multiple=True, help="Network interface for DDS; may be repeated.")
def ros2_command(**options: Any) -> None:  # noqa: ANN401
    """Be a node in ROS 2: /scan and /tf in, /map out.

    ARGUMENTS are ROS's own, after --ros-args.
    """
    from gridslam.cli.ros import ros2

    ros2(**options)


NODE_COMMANDS = (ros1_command, ros2_command)
