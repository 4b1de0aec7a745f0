"""Parameter files of which nothing is for the node: ROS 2 ignores them without a word."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import pairwise

from gridslam.io.ros_parameters import read_parameter_file


def find_foreign_files(arguments: Sequence[str], node: str) -> tuple[str, ...]:
    """Return a sentence for each parameter file in which no section is for the node with this full name.

    Raises
    ------
    InputError
        A parameter file cannot be read.
    """
    files = [path for option, path in pairwise(arguments) if option == "--params-file"]
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


def _node_pattern(pattern: str) -> str:
    """Return the regular expression of a node name in which * matches one part and ** any number."""
    parts = {"**": "(/[^/]+)*", "*": "/[^/]+"}
    return "".join(parts.get(part, "/" + re.escape(part)) for part in pattern.split("/")[1:])
