"""Arguments as ROS 2 takes them, for a machine on which there is no ROS 2 that would.

Source: https://design.ros2.org/articles/ros_command_line_arguments.html
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, final

from gridslam.errors import ConfigurationError

__all__ = ["RosArguments", "parse_ros_arguments"]

_PARAMETER, _REMAP = ("-p", "--param"), ("-r", "--remap")


@final
@dataclass(frozen=True, slots=True)
class RosArguments:
    """What arguments say.

    Attributes
    ----------
    parameters : dict
        Values by name.
    remaps : dict of str to str
        Names that stand for others.
    node, namespace : str
        Of the node; the latter begins with a slash.
    """

    parameters: Mapping[str, Any] = field(default_factory=dict)
    remaps: Mapping[str, str] = field(default_factory=dict)
    node: str = "gridslam"
    namespace: str = "/"

    def resolve(self, name: str) -> str:
        """Full name of a topic or service: remapped, then in the namespace, or in the node's own where it has a ~."""
        full = self._full(name)
        return self._full(self.remaps.get(name) or self.remaps.get(full) or full)

    def _full(self, name: str) -> str:
        space = self.namespace.rstrip("/")
        if name.startswith("~"):
            return f"{space}/{self.node}{name[1:]}"
        return name if name.startswith("/") else f"{space}/{name}"


def parse_ros_arguments(arguments: Sequence[str], node: str = "gridslam") -> RosArguments:
    """Understand ``--ros-args -p particles:=80 -r scan:=front/scan -r __ns:=/robot1``.

    Raises
    ------
    ConfigurationError
        An argument is none of these.
    """
    remaps: dict[str, str] = {}
    parameters: dict[str, Any] = {}
    left = [argument for argument in arguments if argument not in ("--ros-args", "--")]
    while left:
        option = left.pop(0)
        if option not in (*_PARAMETER, *_REMAP) or not left:
            raise ConfigurationError(f"expected -p NAME:=VALUE or -r FROM:=TO, got {option!r}")
        name, value = _split(left.pop(0))
        if option in _REMAP:
            remaps[name] = value
        else:
            parameters[name] = _value(value)
    named = remaps.pop("__node", None) or remaps.pop("__name", None) or node
    space = remaps.pop("__ns", "/")
    return RosArguments(parameters, remaps, named, space if space.startswith("/") else f"/{space}")


def _split(text: str) -> tuple[str, str]:
    name, sign, value = text.partition(":=")
    if not (name and sign and value):
        raise ConfigurationError(f"expected NAME:=VALUE, got {text!r}")
    return name, value


def _value(text: str) -> Any:  # noqa: ANN401
    """A number, a truth value or a list as JSON and YAML write them alike; else the text itself."""
    try:
        return json.loads(text.lower() if text.lower() in ("true", "false") else text)
    except ValueError:
        return text
