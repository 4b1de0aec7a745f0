"""Parser of ROS 2 arguments for machines without ROS 2.

Source: https://design.ros2.org/articles/ros_command_line_arguments.html
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, Final, final

from gridslam.errors import ConfigurationError
from gridslam.io.ros_parameters import read_parameter_file
from gridslam.io.yaml import parse_yaml

_KINDS: Final[tuple[tuple[str, ...], ...]] = (
    ("-p", "--param"),
    ("-r", "--remap"),
    ("--params-file",),
    ("--log-level", "--log-config-file", "-e", "--enclave"),  # without effect here
)
_PARAMETER, _REMAP, _FILE, _OF_ROS = _KINDS
_FLAG_OF_ROS = re.compile("--(enable|disable)-(rosout|stdout|external-lib)-logs")


@final
@dataclass(frozen=True, slots=True)
class RosArguments:
    """Parsed arguments.

    Attributes
    ----------
    parameters : dict
        Values by name.
    remaps : dict of str to str
        New names by old names.
    node, namespace : str
        Name and namespace of the node; the latter begins with a slash.
    ignored : tuple of str
        Arguments that have an effect only in ROS.
    """

    parameters: Mapping[str, Any] = field(default_factory=dict)
    remaps: Mapping[str, str] = field(default_factory=dict)
    node: str = "gridslam"
    namespace: str = "/"
    ignored: tuple[str, ...] = ()

    def resolve(self, name: str) -> str:
        """Return the full name of a topic or service: remapped, in the namespace, or in the node's own after a ~."""
        full = self._full(name)
        return next((self._full(to) for of, to in self.remaps.items() if self._full(of) == full), full)

    def _full(self, name: str) -> str:
        space = self.namespace.rstrip("/")
        if name.startswith("~"):
            return f"{space}/{self.node}{name[1:]}"
        return name if name.startswith("/") else f"{space}/{name}"


def parse_ros_arguments(arguments: Sequence[str], node: str = "gridslam") -> RosArguments:
    """Parse ``--ros-args -p particles:=80 -r scan:=front/scan -r __ns:=/robot1 --params-file robot.yaml``.

    Of two values of one parameter the later one applies, as in ROS.

    Raises
    ------
    ConfigurationError
        An argument has another form.
    InputError
        A parameter file cannot be read.
    """
    settings: list[tuple[tuple[str, ...], str]] = []
    ignored: list[str] = []
    left = [argument for argument in arguments if argument not in ("--ros-args", "--")]
    while left:
        option = left.pop(0)
        kind = next((kind for kind in _KINDS if option in kind), None)
        if _FLAG_OF_ROS.fullmatch(option):
            ignored.append(option)
        elif kind is None or not left:
            expected = "-p NAME:=VALUE, -r FROM:=TO or --params-file FILE"
            raise ConfigurationError(f"expected {expected}, got {option!r}")
        elif kind is _OF_ROS:
            ignored.append(f"{option} {left.pop(0)}")
        else:
            settings.append((kind, left.pop(0)))
    pairs = [_split(text) for kind, text in settings if kind is _REMAP]
    names = {name: value for of, name, value in pairs if of in ("", node)}
    named = names.pop("__node", None) or names.pop("__name", None) or node
    space = f"/{names.pop('__ns', '').strip('/')}"
    remaps = {name: value for of, name, value in pairs if of in ("", named) and not name.startswith("__")}
    parameters: dict[str, Any] = {}
    for kind, text in settings:
        if kind is _FILE:
            parameters |= _read_file(text, f"{space.rstrip('/')}/{named}")
        elif kind is _PARAMETER:
            of, name, value = _split(text)
            is_own = of in ("", named) and not name.startswith("qos_overrides.")  # which are the middleware's
            parameters |= {name: _parse_value(value)} if is_own else {}
    return RosArguments(parameters, remaps, named, space, tuple(ignored))


def find_foreign_files(arguments: Sequence[str], node: str) -> tuple[str, ...]:
    """Return a sentence for each parameter file in which no section is for the node with this full name.

    Raises
    ------
    InputError
        A parameter file cannot be read.
    """
    files = [path for option, path in pairwise(arguments) if option in _FILE]
    return tuple(sentence for path in dict.fromkeys(files) if (sentence := _describe_foreign(path, node)))


def _describe_foreign(path: str, node: str) -> str:
    """Return why a file has no effect on a node; empty if it has."""
    sections = [pattern for pattern, _ in read_parameter_file(path)]
    if any(re.fullmatch(_node_pattern(pattern), node) for pattern in sections):
        return ""
    if not any(sections):
        return f"{path} names no node, so nothing in it is used: put its parameters below /**: and ros__parameters:"
    others = ", ".join(sections)
    start = f"start with -r __node:={sections[0].rpartition('/')[2]}, " if len(sections) == 1 else ""
    return (
        f"{path} has parameters of {others}, none of {node}, so nothing in it is used: {start}or rename the node in it"
    )


def _split(text: str) -> tuple[str, str, str]:
    """Node to which it is restricted, or "", then name and value."""
    name, sign, value = text.partition(":=")
    of, _, name = name.rpartition(":")
    if not (name and sign and value):
        raise ConfigurationError(f"expected NAME:=VALUE, got {text!r}")
    return of, name, value


def _read_file(path: str, node: str) -> dict[str, Any]:
    """Return the parameters of a file for the node with this full name."""
    found: dict[str, Any] = {}
    for pattern, parameters in read_parameter_file(path):
        if re.fullmatch(_node_pattern(pattern), node):
            found |= parameters
    return found


def _node_pattern(pattern: str) -> str:
    """Return the regular expression of a node name in which * matches one part and ** any number."""
    parts = {"**": "(/[^/]+)*", "*": "/[^/]+"}
    return "".join(parts.get(part, "/" + re.escape(part)) for part in pattern.split("/")[1:])


def _parse_value(text: str) -> Any:  # noqa: ANN401
    """Return a YAML number, bool or list; otherwise the text itself."""
    try:
        value = parse_yaml(text)
    except ValueError:
        return text
    return text if value is None or isinstance(value, dict) else value
