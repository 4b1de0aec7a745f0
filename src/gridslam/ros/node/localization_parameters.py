"""Parameters of a node that localizes: those of AMCL, and the node's own."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from gridslam.api.amcl import AMCL_NAMES, from_amcl, override_configuration
from gridslam.api.localization import known_map
from gridslam.errors import ArgumentError, ConfigurationError
from gridslam.ros.node.localization import Localization

__all__ = ["NODE_NAMES", "read_localization"]

NODE_NAMES: Final[Mapping[str, str]] = {
    "base_frame_id": "base_frame", "odom_frame_id": "odom_frame", "global_frame_id": "map_frame",
    "transform_tolerance": "tf_delay",
}  # fmt: skip
"""The node's names of AMCL's parameters."""


def read_localization(given: Mapping[str, Any]) -> tuple[Localization, list[str]]:
    """Return the localization, and the given parameters of AMCL that have no effect.

    Parameters
    ----------
    given : mapping
        ROS parameters set by the user: ``map_file``, ``set``, ``threads`` and AMCL's; others are ignored.

    Raises
    ------
    ConfigurationError
        ``map_file`` is missing, or a parameter is unknown, has a wrong type or is out of range.
    InputError
        The file is not a valid map.
    """
    path = given.get("map_file")
    if not path:
        raise ConfigurationError("map_file: expected the YAML file of the known map, got none")
    amcl = from_amcl({name: value for name, value in given.items() if name in AMCL_NAMES})
    changed = override_configuration(
        amcl.configuration, [part for part in str(given.get("set", "")).split(";") if part.strip()]
    )
    source = changed if changed.pose is not None else amcl
    configuration = changed.configuration
    known = known_map(str(path), configuration, int(given.get("threads", 1)))[1]
    pose = None if source.pose is None else (source.pose, source.covariance)
    if pose is not None:
        try:
            known.require(pose[0])
        except ArgumentError as error:
            raise ConfigurationError(f"initial_{error}") from None
    ignored = [name for name in (*amcl.ignored, *changed.ignored) if name not in NODE_NAMES]
    return Localization(known, configuration, pose), ignored
