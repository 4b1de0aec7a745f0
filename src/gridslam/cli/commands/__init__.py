"""The commands: options are imported when a command is requested, and its code when it runs."""

from __future__ import annotations

import importlib
from typing import Final

import click

from gridslam import __version__
from gridslam.cli.option_types import Number
from gridslam.cli.options import SETTINGS

__all__ = ["gridslam"]

_MODULES: Final = {
    "align": "plans",
    "batch": "batches",
    "changes": "plans",
    "convert": "logs",
    "dataset": "logs",
    "demo": "mapping",
    "doctor": "logs",
    "evaluate": "results",
    "graph": "algorithms",
    "grid": "algorithms",
    "landmarks": "algorithms",
    "localize": "algorithms",
    "map": "mapping",
    "mask": "plans",
    "merge": "mapping",
    "plan": "plans",
    "regress": "results",
    "ros1": "nodes",
    "ros2": "nodes",
    "session": "mapping",
    "simulate": "logs",
    "tune": "batches",
    "view": "results",
}
"""Module of each command."""


class _LazyGroup(click.Group):
    """Group that imports its commands when they are asked for."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names of the commands."""
        return list(_MODULES)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Return a command; None if there is none of that name."""
        if cmd_name not in _MODULES:
            return None
        module = importlib.import_module(f"gridslam.cli.commands.{_MODULES[cmd_name]}")
        command: click.Command = getattr(module, f"{cmd_name}_command")
        return command


@click.group(cls=_LazyGroup, context_settings=SETTINGS, no_args_is_help=False)
@click.version_option(__version__, prog_name="gridslam", message="%(prog)s %(version)s")
@click.option(
    "--max-memory",
    type=Number(0.01, 1e6),
    default=1.0,
    show_default=True,
    metavar="GB",
    help="Reject input that needs more than this much memory.",
)
@click.pass_context
def gridslam(context: click.Context, max_memory: float) -> None:
    """2D lidar SLAM: from a robot's laser scans and odometry to a map and a trajectory.

    Start with `gridslam demo`, which needs no data.
    """
    from gridslam.io.limits import limit_memory

    context.with_resource(limit_memory(round(1e9 * max_memory)))
