"""Parameters of slam_toolbox and of nav2's map_server by their own names, in the node's terms.

Source: slam_toolbox's README and the parameter files in its folder config, https://github.com/SteveMacenski/slam_toolbox.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, Final

from gridslam.errors import ConfigurationError

_MEANINGS: Final[Mapping[str, str]] = {
    "resolution": "delta",
    "max_laser_range": "maxUrange",
    "minimum_travel_distance": "linearUpdate",
    "minimum_travel_heading": "angularUpdate",
    "transform_timeout": "transform_wait",
    "yaml_filename": "map_file",
}
"""The node's names of parameters with another name."""

_OWN_MATCHER = "the scan matcher is another one: parameters of this filter by set"
_OWN_CLOSURE = "loop closure is another one: parameters of this filter by set"
_OWN_SOLVER = "the pose graph has a solver of its own"
_PAGE = "the page of --live serves for that"
_NO_GRAPH = "pose graphs of slam_toolbox cannot be read: continue takes a session, map_file a map"

_IGNORED: Final[Mapping[str, str]] = {
    "solver_plugin": _OWN_SOLVER,
    "ceres_[a-z_]+": _OWN_SOLVER,
    "use_scan_(matching|barycenter)|scan_buffer_[a-z_]+|link_[a-z_]+|correlation_search_space_[a-z_]+": _OWN_MATCHER,
    "(distance|angle)_variance_penalty|minimum_(angle|distance)_penalty|use_response_expansion": _OWN_MATCHER,
    "(fine|coarse)_[a-z_]*angle[a-z_]*|check_min_dist_and_heading_precisely": _OWN_MATCHER,
    "min_pass_through|occupancy_threshold": "the map is of log-odds: see inverse_sensor of set",
    "loop_[a-z_]+": _OWN_CLOSURE,
    "minimum_time_interval": "every scan is tracked",
    "tf_buffer_duration": "transforms are kept for 10 s",
    "scan_queue_size": "the queue is limited by its duration: queue",
    "stack_size_to_use": "no large stack is needed",
    "debug_logging": "/diagnostics has the counts",
    "restamp_tf": "the transform is always stamped tf_delay ahead",
    "use_map_saver": "~/save writes the map, as does any map_saver",
    "enable_interactive_mode|interactive_mode": _PAGE,
    "position_covariance_scale|yaw_covariance_scale": "the covariance is that of the particles",
    "map_file_name|map_start_pose|map_start_at_dock": _NO_GRAPH,
    "lifelong_[a-z_]+": "old key scans are never removed",
    "use_lifecycle_manager|bond_timeout": "the node is not managed: it maps from its start",
    "map_name": "remap the topic map",
    "mode": "a node with a map_file localizes in it, any other one maps",
    "paused_new_measurements": "the service ~/pause pauses the node",
    "laser_frame": "the scan's header names it",
    "publish_occupancy_map|online|sychronous|synchronous": "that is how the node runs anyway",
}
"""Patterns of names without an equivalent, with the reason."""

FOREIGN_NAMES: Final = (*_MEANINGS, "min_laser_range", "do_loop_closing")
"""Names of slam_toolbox and map_server that change something here."""


def translate_parameters(given: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, str], dict[str, str]]:
    """Translate parameters of slam_toolbox.

    Parameters
    ----------
    given : mapping
        Parameters by name. A name of the node itself is stronger than one with the same meaning.

    Returns
    -------
    parameters : dict
        By the node's names; `set` begins with what is a parameter of the filter.
    names : dict of str to str
        The given name for each name that was translated.
    ignored : dict of str to str
        Names without an equivalent, with the reason.

    Raises
    ------
    ConfigurationError
        `min_laser_range` is no number, or `do_loop_closing` no boolean.
    """
    found: dict[str, Any] = {}
    names: dict[str, str] = {}
    ignored: dict[str, str] = {}
    assignments: list[str] = []
    for name, value in given.items():
        meaning = _MEANINGS.get(name)
        if meaning is not None:
            if meaning not in given:
                found[meaning] = value
                names[meaning] = name
        elif name == "min_laser_range":
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise ConfigurationError(f"{name}: expected a number, got {value!r}")
            assignments.append(f"range_min_m={float(value)}")
        elif name == "do_loop_closing":
            if not isinstance(value, bool):
                raise ConfigurationError(f"{name}: expected true or false, got {value!r}")
            assignments += [] if value else ["loop_closure=false"]
        elif reason := next((why for pattern, why in _IGNORED.items() if re.fullmatch(pattern, name)), ""):
            ignored[name] = reason
        else:
            found[name] = value
    if assignments:
        found["set"] = ";".join([*assignments, str(given.get("set", ""))])
    return found, names, ignored
