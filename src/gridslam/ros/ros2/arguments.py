"""Parser of ROS 2 arguments for machines without ROS 2.

Source: https://design.ros2.org/articles/ros_command_line_arguments.html
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any, Final, final

from gridslam.errors import ConfigurationError
from gridslam.io.ros_parameters import read_parameter_file
from gridslam.io.yaml import parse_yaml
from gridslam.ros.rtps.qos import Qos

_KINDS: Final[tuple[tuple[str, ...], ...]] = (
    ("-p", "--param"),
    ("-r", "--remap"),
    ("--params-file",),
    ("--log-level", "--log-config-file", "-e", "--enclave"),  # without effect here
)
_PARAMETER, _REMAP, _FILE, _OF_ROS = _KINDS
_POLICIES: Final[Mapping[str, Mapping[str, tuple[str, bool]]]] = {
    "reliability": {"reliable": ("reliable", True), "best_effort": ("reliable", False)},
    "durability": {"transient_local": ("latched", True), "volatile": ("latched", False)},
    "history": {"keep_last": ("", False)},
}
"""Attribute of `Qos` and its value, for each value of a policy."""

_OVERRIDE = re.compile(r"qos_overrides\.([^.]+)\.(publisher|subscription)\.(\w+)")
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
    qos_overrides : dict
        Values by topic, "publisher" or "subscription", and policy.
    """

    parameters: Mapping[str, Any] = field(default_factory=dict)
    remaps: Mapping[str, str] = field(default_factory=dict)
    node: str = "gridslam"
    namespace: str = "/"
    ignored: tuple[str, ...] = ()
    qos_overrides: Mapping[tuple[str, str, str], Any] = field(default_factory=dict)

    def resolve(self, name: str) -> str:
        """Return the full name of a topic or service: remapped, in the namespace, or in the node's own after a ~."""
        full = self._full(name)
        return next((self._full(to) for of, to in self.remaps.items() if self._full(of) == full), full)

    def override_qos(self, topic: str, side: str, qos: Qos) -> Qos:
        """Return the quality of service of a topic, by its full name, on a side: "publisher" or "subscription".

        Raises ConfigurationError for a policy with another value than ROS's.
        """
        changes: dict[str, Any] = {}
        for (of, which, policy), value in self.qos_overrides.items():
            if (self._full(of), which) != (topic, side):
                continue
            name = f"qos_overrides.{of}.{which}.{policy}"
            if policy == "depth" and isinstance(value, int) and not isinstance(value, bool) and value > 0:
                changes["depth"] = value
            elif (known := _POLICIES.get(policy, {}).get(str(value))) is not None:
                changes |= {known[0]: known[1]} if known[0] else {}
            elif policy in ("depth", *_POLICIES):
                expected = "a number above 0" if policy == "depth" else " or ".join(_POLICIES[policy])
                raise ConfigurationError(f"{name}: expected {expected}, got {value!r}")
        return replace(qos, **changes)

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
            parameters |= {name: _parse_value(value)} if of in ("", named) else {}
    found = {name: _OVERRIDE.fullmatch(name) for name in parameters}
    overrides = {(match[1], match[2], match[3]): parameters.pop(name) for name, match in found.items() if match}
    return RosArguments(parameters, remaps, named, space, tuple(ignored), overrides)


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
    for pattern, parameters in read_parameter_file(path, keeps_qos=True):
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
