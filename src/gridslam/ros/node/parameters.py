"""Parameters of the node: those of slam_gmapping with their names and defaults, those of AMCL, and its own.

Source: the public documentation of the ROS package gmapping, http://wiki.ros.org/gmapping, section Parameters.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Annotated, Any, Final, Literal, TypeAlias, final

from pydantic import AfterValidator, ConfigDict, Field, ValidationError
from pydantic.dataclasses import dataclass as parameters

from gridslam.api.amcl import AMCL_NAMES, from_amcl, override_configuration
from gridslam.api.localization import known_map
from gridslam.config import Configuration, load, override, preset
from gridslam.config.tables import describe_error, names, nest, replace_parameters, suggest_names
from gridslam.errors import ArgumentError, ConfigurationError
from gridslam.io.ros_parameters import flatten_parameters
from gridslam.ros.node.continued import Continued
from gridslam.ros.node.live_autosave import AUTOSAVE, SessionFiles
from gridslam.ros.node.session import Localization

_GROWS, _NOT_SAMPLED = "the map grows by itself", "the likelihood around a match is not sampled"
_GMAPPING: Final[tuple[tuple[str, float | int | str, str, str], ...]] = (
    ("throttle_scans", 1, "throttle_scans", ""),
    ("base_frame", "base_link", "base_frame", ""),
    ("map_frame", "map", "map_frame", ""),
    ("odom_frame", "odom", "odom_frame", ""),
    ("map_update_interval", 5.0, "map_update_interval_s", ""),
    ("maxUrange", 80.0, "", ""),
    ("sigma", 0.05, "proposal.matcher.scale_m2", ""),
    ("kernelSize", 1, "", ""),
    ("lstep", 0.05, "proposal.matcher.step_m", ""),
    ("astep", 0.05, "proposal.matcher.step_rad", ""),
    ("iterations", 5, "proposal.matcher.halvings", ""),
    ("lsigma", 0.075, "sensor.scale_m2", ""),
    ("ogain", 3.0, "", ""),
    ("lskip", 0, "sensor.skip", ""),
    ("minimumScore", 0.0, "proposal.matcher.minimum_score", ""),
    ("srr", 0.1, "motion.srr", ""),
    ("srt", 0.2, "motion.srt", ""),
    ("str", 0.1, "motion.str", ""),
    ("stt", 0.2, "motion.stt", ""),
    ("linearUpdate", 1.0, "when_to_update.translation_m", ""),
    ("angularUpdate", 0.5, "when_to_update.rotation_rad", ""),
    ("temporalUpdate", -1.0, "", "a robot at rest adds nothing to the map"),
    ("resampleThreshold", 0.5, "when_to_resample.fraction", ""),
    ("particles", 30, "particles", ""),
    *(
        (name, side, "", _GROWS)
        for name, side in {"xmin": -100.0, "ymin": -100.0, "xmax": 100.0, "ymax": 100.0}.items()
    ),
    ("delta", 0.05, "mapper.resolution_m", ""),
    *((name, 0.01, "", _NOT_SAMPLED) for name in ("llsamplerange", "llsamplestep")),
    *((name, 0.005, "", _NOT_SAMPLED) for name in ("lasamplerange", "lasamplestep")),
    ("transform_publish_period", 0.05, "transform_publish_period_s", ""),
    ("tf_delay", 0.05, "tf_delay_s", ""),
    ("occ_thresh", 0.25, "", "cells are occupied above probability 0.65 and free below 0.196"),
    ("maxRange", 80.0, "", ""),
)
"""slam_gmapping's parameters: name, default, the field of `NodeSettings` or the parameter of the filter that it is, and
why it has no equivalent; the others are in `_DERIVED`."""

_OWN: Final[tuple[tuple[str, float | int | str | bool, str], ...]] = (
    ("preset", "", ""),
    ("config", "", ""),
    ("set", "", ""),
    ("seed", 0, "seed"),
    ("threads", 1, "threads"),
    ("odometry", "needed", "odometry"),
    ("transform_wait", 0.5, "transform_wait_s"),
    ("extrapolate", 0.15, "extrapolate_s"),
    ("extrapolate_after", 0.03, "extrapolate_after_s"),
    ("queue", 0.75, "queue_s"),
    ("record", "", ""),
    ("out", "", ""),
    ("save", "", ""),
    ("continue", "", ""),
    ("autosave", 5.0, ""),
    ("map_file", "", ""),
    ("scan_topic", "scan", "scan_topic"),
    ("tf_broadcast", True, ""),
)
"""The node's own parameters: name, default, and the field of `NodeSettings` that it is."""

GMAPPING_DEFAULTS: Final[Mapping[str, float | int | str]] = {name: default for name, default, _, _ in _GMAPPING}
"""slam_gmapping's parameters and defaults; `maxRange` defaults to the laser's, `tf_delay` to the publish period."""

NODE_DEFAULTS: Final[Mapping[str, float | int | str | bool]] = {name: default for name, default, _ in _OWN}
"""The node's own parameters and defaults: see docs/ros.md."""

_DERIVED: Final[Mapping[str, tuple[str, ...]]] = {
    "kernelSize": ("proposal.matcher.kernel_m", "sensor.kernel_m"),
    "ogain": ("sensor.likelihood_gain",),
    "maxUrange": ("range_max_m",),
    "maxRange": ("range_max_m",),
}
"""The filter's parameters that are derived from one or several parameters of slam_gmapping."""

_UNSUPPORTED: Final[Mapping[str, str]] = {
    **{name: reason for name, _, _, reason in _GMAPPING if reason},
    "inverted_laser": "the mounting is taken from the transforms",
}
"""Parameters without an equivalent, with the reason."""

_ALMOST_ZERO = 1e-9

_AMCL_NODE: Final[Mapping[str, str]] = {
    "base_frame_id": "base_frame",
    "odom_frame_id": "odom_frame",
    "global_frame_id": "map_frame",
    "transform_tolerance": "tf_delay",
}
"""The node's names of AMCL's parameters."""


def _strip_slash(frame: str) -> str:
    if not (bare := frame.lstrip("/")):
        raise ValueError("expected the name of a frame")
    return bare


Frame: TypeAlias = Annotated[str, AfterValidator(_strip_slash)]
"""Name of a frame without tf1's leading slash: "/odom" becomes "odom"."""


@final
@parameters(frozen=True, config=ConfigDict(extra="forbid"))
class NodeSettings:
    """Frames, rates and bounds of the node; the defaults with a ROS name are slam_gmapping's.

    Parameters
    ----------
    scan_topic : str
        Topic of the scans.
    base_frame, odom_frame, map_frame : str
        Frames of the robot, its odometry and the map.
    odometry : str
        "needed": scans without odometry are refused; "optional": they are matched without; "none": odometry is ignored.
    map_update_interval_s : float, s
        Time between two maps; 0: a map after each scan, as fast as rendering permits.
    transform_publish_period_s : float, s
        Time between two transforms from map to odometry; 0: no transform is published.
    tf_delay_s : float, s
        How far in the future that transform is stamped, i.e. how long it is valid.
    throttle_scans : int
        Use every n-th scan.
    transform_wait_s : float, s
        How long a scan waits for the transforms at its stamp.
    extrapolate_s, extrapolate_after_s : float, s
        If a scan has waited for its odometry by the latter, the odometry is extrapolated with its velocity, by the
        former at most (the period of 10 Hz and a half); 0: it waits.
    queue_s, catch_up_s, queue_scans : float in s, float in s, int
        Limits of the queue. Where the filter has not caught up with the scans for `catch_up_s`, those older than the
        newest by more than `queue_s` are dropped, and at any time those beyond this number, oldest first: a machine
        that is too slow is never further behind, and one that pauses loses no scan. Transforms are kept for 10 s.
    jump_s : float, s
        Time has jumped back if two scans in a row are stamped this much before the last one.
    min_beams, max_beams : int
        Scans with fewer or more beams are refused.
    seed, threads : int
        As in `map_log`: the generator is re-seeded for each session; the threads do not affect results.
    """

    scan_topic: str = Field(default="scan", min_length=1)
    base_frame: Frame = "base_link"
    odom_frame: Frame = "odom"
    map_frame: Frame = "map"
    odometry: Literal["needed", "optional", "none"] = "needed"
    map_update_interval_s: float = Field(default=5.0, ge=0)
    transform_publish_period_s: float = Field(default=0.05, ge=0)
    tf_delay_s: float = Field(default=0.05, ge=0)
    throttle_scans: int = Field(default=1, ge=1)
    transform_wait_s: float = Field(default=0.5, ge=0)
    extrapolate_s: float = Field(default=0.15, ge=0, le=1)
    extrapolate_after_s: float = Field(default=0.03, ge=0)
    queue_s: float = Field(default=0.75, gt=0)
    catch_up_s: float = Field(default=8.0, ge=0)
    queue_scans: int = Field(default=1000, ge=1)
    jump_s: float = Field(default=1.0, gt=0)
    min_beams: int = Field(default=10, ge=1)
    max_beams: int = Field(default=100_000, ge=1)
    seed: int = Field(default=0, ge=0)
    threads: int = Field(default=1, ge=1, le=256)


_FIELDS: Final = frozenset(each.name for each in fields(NodeSettings))
_NODE: Final[Mapping[str, str]] = {
    **{name: target for name, _, target, _ in _GMAPPING if target in _FIELDS},
    **{name: target for name, _, target in _OWN if target},
}
"""The field of `NodeSettings` for each parameter that is one."""

_FILTER: Final[Mapping[str, str]] = {name: target for name, _, target, _ in _GMAPPING if target and name not in _NODE}
"""The filter's parameter for each parameter of slam_gmapping."""

_PATHS: Final[Mapping[str, tuple[str, ...]]] = {**{name: (path,) for name, path in _FILTER.items()}, **_DERIVED}
"""All parameters of the filter for each parameter of slam_gmapping."""


@final
@dataclass(frozen=True, slots=True)
class NodeParameters:
    """Settings and configuration from ROS parameters.

    Attributes
    ----------
    settings : NodeSettings
        Settings of the node.
    configuration : Configuration or Localization
        Configuration of the filter; `Localization` if the map is known.
    warning : str
        The ignored parameters with the reasons; empty if there are none.
    record, out : Path or None
        File for the accepted scans, and output folder.
    files : SessionFiles
        What the first mapping session goes on from, and where it is saved.
    """

    settings: NodeSettings
    configuration: Configuration | Localization
    warning: str
    record: Path | None
    out: Path | None
    files: SessionFiles = field(default_factory=SessionFiles)


def node_parameters(given: Mapping[str, Any], preset_name: str = "gmapping") -> NodeParameters:
    """Convert ROS parameters to the node's settings and the filter's configuration.

    With the preset "gmapping" all of `GMAPPING_DEFAULTS` hold unless they are given. Another preset is changed only by
    what is given, and parameters that it has no part for are ignored.

    Parameters
    ----------
    given : mapping
        Parameters set by the user: of `GMAPPING_DEFAULTS`, `NODE_DEFAULTS` or AMCL; others are ignored.
        Tables are flattened: `initial_pose: {x: 1}` is `initial_pose.x`.
    preset_name : str
        The preset if `given` has none.

    Raises
    ------
    ConfigurationError
        A value has a wrong type or is out of range, the preset does not exist, or a node that localizes has no map.
    InputError
        The file of the map or of the configuration cannot be read.
    """
    given = flatten_parameters(given)
    values = {**NODE_DEFAULTS, **{name: value for name, value in given.items() if name in NODE_DEFAULTS}}
    given = {name: _as_roscpp(name, value) for name, value in given.items()}
    configuration: Configuration | Localization
    files = SessionFiles()
    record, out = (Path(str(values[name])) if values[name] else None for name in ("record", "out"))
    if values["map_file"]:
        out = None
        configuration, reasons = _read_localization(given)
        given = {_AMCL_NODE.get(name, name): value for name, value in given.items()}
    else:
        configuration, reasons = _read_mapping(given, str(values["preset"]) or preset_name)
        files = _read_session_files(values, out, int(given.get("threads", 1)))
    if files.continued is not None:
        configuration = files.continued.saved.configuration
        own = "the session's own configuration is used"
        reasons |= {name: own for name in given if name in (*_PATHS, "preset", "config", "set", "seed")}
    if not isinstance(values["tf_broadcast"], bool):
        raise ConfigurationError(f"tf_broadcast: expected true or false, got {values['tf_broadcast']!r}")
    if not values["tf_broadcast"]:
        given["transform_publish_period"] = 0.0
    warning = _group_by_reason(reasons)
    return NodeParameters(_read_settings(given), configuration, warning, record, out, files)


def _read_session_files(values: Mapping[str, Any], out: Path | None, threads: int) -> SessionFiles:
    """Read the session that the node goes on from, and where it saves its own."""
    minutes = values["autosave"]
    if isinstance(minutes, bool) or not isinstance(minutes, int | float) or not 0 <= minutes < math.inf:
        raise ConfigurationError(f"autosave: expected a number of minutes, 0 for none, got {minutes!r}")
    continued = Continued.read(str(values["continue"]), threads) if values["continue"] else None
    save = Path(str(values["save"])) if values["save"] else None
    autosave = save if out is None else out / AUTOSAVE
    return SessionFiles(continued, save, autosave if minutes else None, 60.0 * minutes)


def _read_mapping(given: Mapping[str, Any], preset_name: str) -> tuple[Configuration, dict[str, str]]:
    """Return the configuration, and why given parameters have no effect."""
    base = preset(preset_name)
    there = set(names(base))
    current = {**GMAPPING_DEFAULTS, **given} if preset_name == "gmapping" else given
    direct = {path: current[name] for name, path in _FILTER.items() if name in current and path in there}
    try:
        config = replace_parameters(base, nest(direct))
        config = replace_parameters(config, nest(_derived_values(base, given, current)))
    except ConfigurationError as error:
        raise _with_ros_name(error) from None
    if given.get("config"):
        config = load(str(given["config"]), config)
    reasons = {}
    for name in given:
        if name in _UNSUPPORTED:
            reasons[name] = _UNSUPPORTED[name]
        elif name in _PATHS:
            if not there.intersection(_PATHS[name]):
                reasons[name] = f"the preset {preset_name} has no such part"
        elif name not in _NODE and name not in NODE_DEFAULTS:
            known = [*GMAPPING_DEFAULTS, *NODE_DEFAULTS]
            reasons[name] = f"there is no such parameter{suggest_names(name, known)}"
    return override(config, *_assignments(given)), reasons


def _read_localization(given: Mapping[str, Any]) -> tuple[Localization, dict[str, str]]:
    """Return the localization, and why given parameters have no effect: AMCL's hold instead of slam_gmapping's."""
    amcl = from_amcl({name: value for name, value in given.items() if name in AMCL_NAMES})
    changed = override_configuration(amcl.configuration, _assignments(given))
    source = changed if changed.pose is not None else amcl
    known = known_map(str(given["map_file"]), changed.configuration, int(given.get("threads", 1)))[1]
    pose = None if source.pose is None else (source.pose, source.covariance)
    if pose is not None:
        try:
            known.require(pose[0])
        except ArgumentError as error:
            raise ConfigurationError(f"initial_{error}") from None
    ignored = [name for name in (*amcl.ignored, *changed.ignored) if name not in (*_AMCL_NODE, *NODE_DEFAULTS)]
    reasons = dict.fromkeys(ignored, "it has no equivalent")
    for name in given:
        if name in (*_PATHS, *_UNSUPPORTED, "preset", "config", "out", "save", "continue", "autosave"):
            reasons[name] = "the node localizes and builds no map"
        elif name not in (*_NODE, *NODE_DEFAULTS, *AMCL_NAMES):
            reasons[name] = f"there is no such parameter{suggest_names(name, [*AMCL_NAMES, *_NODE, *NODE_DEFAULTS])}"
    return Localization(known, changed.configuration, pose), reasons


def _assignments(given: Mapping[str, Any]) -> list[str]:
    """Return the parts of `set`: parameters of the filter by their names."""
    return [part for part in str(given.get("set", "")).split(";") if part.strip()]


def _as_roscpp(name: str, value: Any) -> Any:  # noqa: ANN401
    """Convert a value as slam_gmapping does: 30.0 is a number of particles, and a threshold may be 0."""
    if isinstance(GMAPPING_DEFAULTS.get(name), int) and isinstance(value, float) and value.is_integer():
        return int(value)
    if name in ("linearUpdate", "angularUpdate", "resampleThreshold") and value == 0:
        return _ALMOST_ZERO
    return value


def _with_ros_name(error: ConfigurationError) -> ConfigurationError:
    """Replace the filter's name of a parameter by its ROS name."""
    path, _, problem = str(error).partition(": ")
    ros_names = [name for name in GMAPPING_DEFAULTS if path in _PATHS.get(name, ())]
    return ConfigurationError(f"{' and '.join(ros_names) or path}: {problem}")


def _derived_values(base: Configuration, given: Mapping[str, Any], current: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of derived parameters, by dotted names."""
    values: dict[str, Any] = {}
    there = set(names(base))

    def number(name: str, otherwise: float) -> float:
        value = current.get(name, otherwise)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ConfigurationError(f"{name}: expected a number, got {value!r}")
        return float(value)

    if "sensor.kernel_m" in there:  # a circle as wide as the square of cells
        kernel_m = round((number("kernelSize", 1) + 0.5) * number("delta", base.mapper.resolution_m), 9)
        values |= dict.fromkeys(_DERIVED["kernelSize"], kernel_m)
    if "sensor.likelihood_gain" in there:
        values["sensor.likelihood_gain"] = number("ogain", 3.0) * number("particles", base.particles)
    if "maxUrange" in current or "maxRange" in current:
        bounds = [number(name, 80.0) for name in ("maxUrange", "maxRange") if name in given]
        values["range_max_m"] = min(bounds, default=80.0)
    return {path: value for path, value in values.items() if path in there}


def _read_settings(given: Mapping[str, Any]) -> NodeSettings:
    values = {field: given[name] for name, field in _NODE.items() if name in given}
    if "tf_delay" not in given and "transform_publish_period" in given:
        values["tf_delay_s"] = given["transform_publish_period"]
    try:
        return NodeSettings(**values)
    except ValidationError as error:
        field, _, problem = describe_error(error.errors()[0], values).partition(": ")
        name = next((name for name, known in _NODE.items() if known == field), field)
        raise ConfigurationError(f"{name}: {problem}") from None


def _group_by_reason(reasons: Mapping[str, str]) -> str:
    """Return a message with the ignored parameters, grouped by reason."""
    by_reason: dict[str, list[str]] = {}
    for name, reason in reasons.items():
        by_reason.setdefault(reason, []).append(name)
    ignored_text = "; ".join(f"{', '.join(ignored)} ({reason})" for reason, ignored in by_reason.items())
    return f"ignored parameters: {ignored_text}" if ignored_text else ""
