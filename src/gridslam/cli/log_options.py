"""The options that choose what is read of a log, shared by all commands that read one."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, TypeVar

import click

__all__ = ["log_options"]

_Command = TypeVar("_Command", bound=Callable[..., Any])

_SPAN = (
    click.option("--start", "start_s", type=float, default=0, metavar="S", help="Skip the first S seconds of the log."),
    click.option("--duration", "duration_s", type=float, metavar="S", help="Read only S seconds."),
    click.option("--every", type=click.IntRange(min=1), default=1, metavar="N", help="Use only every N-th scan."),
)
_SOURCES = (
    click.option("--scan", "scan_topics", multiple=True, metavar="TOPIC", help="Topic of the scans; may be repeated."),
    click.option("--odom", "odometry_topic", metavar="TOPIC", help="Topic of the odometry."),
    click.option("--odom-frame", "odometry_frame", metavar="FRAME", help="Odometry frame; take the odometry from /tf."),
    click.option("--base-frame", metavar="FRAME", help="Base frame of the robot (REP-105 base_link)."),
    click.option("--no-odometry", is_flag=True, help="Ignore the odometry."),
    click.option("--keep-truncated", is_flag=True, help="Accept a truncated log and read the part that exists."),
)
_FIELDS = (
    "scan_topics", "odometry_topic", "odometry_frame", "base_frame", "no_odometry", "keep_truncated", "start_s",
    "duration_s", "every",
)  # fmt: skip


def log_options(command: _Command) -> _Command:
    """Add the options to a command, which gets them as one `LogOptions` named ``options``."""

    @functools.wraps(command)
    def wrapper(**given: Any) -> Any:  # noqa: ANN401
        from gridslam.errors import ArgumentError
        from gridslam.io.log import LogOptions

        fields = {name: given.pop(name) for name in _FIELDS}
        try:
            options = LogOptions(**fields)
        except ArgumentError as error:
            raise click.ClickException(f"--{str(error).replace('_s:', ':', 1)}") from None
        return command(options=options, **given)

    for option in reversed((*_SOURCES, *_SPAN)):
        wrapper = option(wrapper)
    return wrapper  # type: ignore[return-value]
