"""Parameter files of ROS: YAML with the parameters of one node, or of several below `ros__parameters`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from gridslam.errors import InputError
from gridslam.io.text import read_text, refuse_unreadable
from gridslam.io.yaml import parse_yaml

_LARGEST_BYTES = 1 << 18


def read_parameter_file(path: str | Path) -> list[tuple[str, dict[str, Any]]]:
    """Read the nodes of a parameter file, in its order: their names, and their values by dotted names.

    A name is the full one of the node, `/robot1/amcl`, or a pattern of full names, `/**`. Files of ROS 1 hold the
    parameters of one node; its name is then empty. Tables of parameters are flattened: `initial_pose: {x: 1}` is the
    parameter `initial_pose.x`. `qos_overrides` are the middleware's, and left out.

    Raises
    ------
    InputError
        The file cannot be read, is no YAML, or holds no parameters.

    References
    ----------
    ROS 2 Design, ROS Command Line Arguments, section Parameter files.
    """
    with refuse_unreadable(path, "'name: value' in YAML"):
        tree = parse_yaml(read_text(path, _LARGEST_BYTES))
    if not isinstance(tree, dict):
        raise InputError(path, f"expected 'name: value' in YAML, got {tree!r:.60}")
    nodes = list(_find_nodes(tree, "")) or [("", tree)]
    for name, parameters in nodes:
        if not isinstance(parameters, dict):
            raise InputError(path, f"expected parameters below ros__parameters of {name}, got {parameters!r}")
    return [(name, flatten_parameters(parameters)) for name, parameters in nodes]


def _find_nodes(tree: Any, above: str) -> Iterator[tuple[str, Any]]:  # noqa: ANN401
    """Name of each node in a tree of parameters, and its parameters."""
    for name, below in tree.items() if isinstance(tree, dict) else ():
        if name == "ros__parameters":
            yield above, below
        else:
            yield from _find_nodes(below, f"{above}/{str(name).strip('/')}")


def flatten_parameters(table: Mapping[str, Any]) -> dict[str, Any]:
    """Return parameters by dotted names: `initial_pose: {x: 1}` is the parameter `initial_pose.x`."""
    found: dict[str, Any] = {}
    for key, value in table.items():
        name = str(key)  # YAML has keys of other kinds
        if name.partition(".")[0] == "qos_overrides":
            continue
        if isinstance(value, Mapping):
            found |= {f"{name}.{below}": own for below, own in flatten_parameters(value).items()}
        else:
            found[name] = value
    return found
