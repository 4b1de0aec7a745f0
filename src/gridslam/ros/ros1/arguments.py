"""Check of ROS 1 arguments, of which rospy ignores those that it does not understand."""

from __future__ import annotations

from collections.abc import Sequence

from gridslam.errors import ConfigurationError
from gridslam.ros.node.parameters import GMAPPING_DEFAULTS, NODE_DEFAULTS

__all__ = ["check_ros1_arguments"]


def check_ros1_arguments(arguments: Sequence[str]) -> None:
    """Raise ConfigurationError for an argument other than ``name:=value`` and a parameter without its underscore."""
    for argument in arguments:
        name, sign, _ = argument.partition(":=")
        if not sign or not name or name.startswith("-"):
            raise ConfigurationError(f"expected an option, _PARAMETER:=VALUE or TOPIC:=OTHER, got {argument!r}")
        if name in GMAPPING_DEFAULTS or name in NODE_DEFAULTS:
            raise ConfigurationError(f"{argument}: this would remap a topic; a parameter is given as _{argument}")
