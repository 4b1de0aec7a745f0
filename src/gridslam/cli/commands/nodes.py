"""gridslam ros1 and ros2: options and help."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import click

from gridslam.cli.option_types import OUTPUT_FILE, OUTPUT_FOLDER, PATH, SEED, THREADS, Number
from gridslam.cli.options import SETTINGS, add_options, assignment_option, calls, robot_live_options

_NODE_OPTIONS = (
    click.argument("arguments", nargs=-1, type=click.UNPROCESSED),
    click.option("--preset", help="Preset: default or gmapping."),
    click.option("--particles", type=int, help="Number of particles."),
    click.option("--seed", type=SEED, help="Random seed; equal seeds and scans give equal results."),
    click.option("--threads", type=THREADS, help="Number of threads; does not affect the results."),
    click.option("--config", type=PATH, help="TOML file with parameters; overrides the preset."),
    assignment_option(help="Set one parameter (see map)."),
    click.option("--map", "map_file", type=PATH, help="Map YAML file; localize in this map instead of mapping."),
    click.option("-o", "--out", type=OUTPUT_FOLDER, help="Output folder of the node."),
    click.option(
        "--record", type=OUTPUT_FILE, metavar="FILE", help="Record the accepted scans to FILE for offline mapping."
    ),
    click.option("--save", type=OUTPUT_FILE, metavar="FILE", help="Save the session to this file at the end."),
    click.option("--continue", "continued", type=PATH, metavar="FILE", help="Continue this session file."),
    click.option(
        "--autosave",
        type=Number(0),
        metavar="MINUTES",
        help="Minutes between two saves to autosave.gridslam in OUT; 0: none.  [default: 5]",
    ),
)


_NODE_SETTINGS = {**SETTINGS, "ignore_unknown_options": True}


def node_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of a node to its command."""
    return add_options(robot_live_options(command), _NODE_OPTIONS)


@click.command("ros1", context_settings=_NODE_SETTINGS)
@node_options
@calls("ros:ros1")
def ros1_command() -> None:
    """Run the ROS 1 node, a drop-in replacement for slam_gmapping: subscribes to /scan and /tf, publishes /map.

    ARGUMENTS are ROS arguments: _name:=value sets a parameter, name:=other remaps a topic.
    """


@click.command("ros2", context_settings=_NODE_SETTINGS)
@node_options
@calls("ros:ros2")
def ros2_command() -> None:
    """Run the ROS 2 node: subscribes to /scan and /tf, publishes /map.

    ARGUMENTS are ROS arguments after --ros-args.
    """
