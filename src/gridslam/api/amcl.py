"""Parameters of localization by name: AMCL's, of ROS 1 and of nav2, and gridslam's own."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final, NamedTuple, final

import numpy as np

from gridslam.config.tables import nest, read_assignments, replace_parameters, suggest_names
from gridslam.errors import ConfigurationError, InputError
from gridslam.io.ros_parameters import read_parameter_file
from gridslam.localization.monte_carlo import MonteCarloConfiguration
from gridslam.models.motion import OdometryMotion
from gridslam.parameters import Table, to_table
from gridslam.types import FloatArray

_POSE = ("initial_pose_x", "initial_pose_y", "initial_pose_a")
_TABLE: Final[tuple[tuple[str, str, Any, Any, str], ...]] = (
    ("min_particles", "", 100, 500, "kld.particles_min"),
    ("max_particles", "", 5000, 2000, "kld.particles_max"),
    ("kld_err", "pf_err", 0.01, 0.05, "kld.error"),
    ("kld_z", "pf_z", 0.99, 0.99, "kld.z"),
    ("update_min_d", "", 0.2, 0.25, "when_to_update.translation_m"),
    ("update_min_a", "", math.pi / 6, 0.2, "when_to_update.rotation_rad"),
    ("resample_interval", "", 2, 1, "resample_interval"),
    ("recovery_alpha_slow", "", 0.0, 0.0, "recovery.alpha_slow"),
    ("recovery_alpha_fast", "", 0.0, 0.0, "recovery.alpha_fast"),
    *((f"odom_alpha{k}", f"alpha{k}", 0.2, 0.2, f"motion.alpha{k}") for k in range(1, 5)),
    ("odom_alpha5", "alpha5", None, None, ""),
    ("laser_max_beams", "max_beams", 30, 60, "max_beams"),
    ("laser_z_hit", "z_hit", 0.95, 0.5, ""),
    ("laser_z_short", "z_short", 0.1, 0.05, ""),
    ("laser_z_max", "z_max", 0.05, 0.05, ""),
    ("laser_z_rand", "z_rand", 0.05, 0.5, ""),
    ("laser_sigma_hit", "sigma_hit", 0.2, 0.2, "sensor.sigma_hit_m"),
    ("laser_lambda_short", "lambda_short", 0.1, 0.1, ""),
    ("laser_likelihood_max_dist", "", 2.0, 2.0, "reach_m"),
    ("laser_min_range", "", None, None, "range_min_m"),
    ("laser_max_range", "", None, 100.0, "range_max_m"),
    ("laser_model_type", "", "likelihood_field", "likelihood_field", ""),
    ("odom_model_type", "robot_model_type", "diff", "nav2_amcl::DifferentialMotionModel", ""),
    ("selective_resampling", "", False, None, ""),
    ("set_initial_pose", "", None, None, ""),
    *((name, f"initial_pose.{axis}", None, None, "") for name, axis in zip(_POSE, ("x", "y", "yaw"), strict=True)),
)
"""AMCL's parameters: the name in ROS 1, another one in nav2, the defaults in both, and the parameter here if any."""

AMCL_DEFAULTS: Final[Mapping[str, Mapping[str, Any]]] = {
    "amcl": {name: default for name, _, default, _, _ in _TABLE if default is not None},
    "nav2": {other or name: default for name, other, _, default, _ in _TABLE if default is not None},
}
"""The defaults of ROS 1's amcl and of nav2's, each by its own names."""

_COVARIANCE: Final[Mapping[str, tuple[int, int]]] = {
    f"initial_cov_{name}": place
    for name, place in {"xx": (0, 0), "yy": (1, 1), "aa": (2, 2), "xy": (0, 1), "xa": (0, 2), "ya": (1, 2)}.items()
}
_ALIASES: Final[Mapping[str, str]] = {
    **{other: name for name, other, *_ in _TABLE if other},
    "initial_pose_yaw": "initial_pose_a",
    **{
        f"initial_pose{mark}covariance_{beluga}": name
        for mark in "._"  # of Beluga's ROS 2 node, and of its nodelet
        for name, beluga in zip(_COVARIANCE, ("x", "y", "yaw", "xy", "xyaw", "yyaw"), strict=True)
    },
}
_PLACES: Final = {name: place for name, _, _, _, place in _TABLE if place}
_SHARES = {f"laser_z_{kind}": f"z_{kind}" for kind in ("hit", "short", "max", "rand")}
_BINS = ("spatial_resolution_x", "spatial_resolution_y", "spatial_resolution_theta")
_COUNTS = ("min_particles", "max_particles", "resample_interval", "laser_max_beams")
_ALMOST_ZERO = 1e-9
_IGNORED: Final = tuple(
    """
    odom_alpha5 do_beamskip beam_skip_distance beam_skip_threshold beam_skip_error_threshold base_frame_id
    odom_frame_id global_frame_id tf_broadcast transform_tolerance gui_publish_rate save_pose_rate use_map_topic
    first_map_only always_reset_initial_pose scan_topic map_topic map_service initial_pose.z initial_pose_topic
    use_sim_time execution_policy model_unknown_space freespace_downsampling random_seed restore_defaults
    bond_heartbeat_period introspection_mode force_update_after_initialpose force_update_after_set_map
    std_warn_level_x std_warn_level_y std_warn_level_yaw
    """.split()  # noqa: SIM905 one name a line would be half a page
)

AMCL_NAMES: Final = frozenset((*(name for name, *_ in _TABLE), *_COVARIANCE, *_BINS, *_IGNORED, *_ALIASES))
"""Every name that `from_amcl` knows."""


@final
class AmclParameters(NamedTuple):
    """The parameters of AMCL, mapped to gridslam's.

    Attributes
    ----------
    configuration : MonteCarloConfiguration
    pose : (3,) float64 or None
        Initial pose, where one of its coordinates is given and `set_initial_pose` is not false.
    covariance : (3, 3) float64
        Of that pose; AMCL's default where none is given.
    ignored : tuple of str
        Names that are known but mean nothing here.
    """

    configuration: MonteCarloConfiguration
    pose: FloatArray | None
    covariance: FloatArray
    ignored: tuple[str, ...]


def from_amcl(parameters: Mapping[str, Any], base: MonteCarloConfiguration | None = None) -> AmclParameters:
    """Read AMCL's parameters, by the names of ROS 1, nav2 or Beluga; parameters that are not given stay as in `base`.

    A pose whose `set_initial_pose` is false is ignored, as in nav2. A holonomic robot keeps gridslam's own motion
    model, which has noise across the motion, and its `alpha`s are ignored.

    Parameters
    ----------
    parameters : mapping of str to object
        For all of AMCL's defaults begin with `AMCL_DEFAULTS`.
    base : MonteCarloConfiguration, optional
        The defaults of gridslam if not given.

    Raises
    ------
    ConfigurationError
        A name is unknown, or a value is of a wrong type or out of range.
    """
    unknown = [name for name in parameters if name not in AMCL_NAMES]
    if unknown:
        raise ConfigurationError(f"{unknown[0]}: AMCL has no such parameter{suggest_names(unknown[0], AMCL_NAMES)}")
    _check_values(parameters)
    spelled = {_ALIASES.get(name, name): name for name in parameters}
    given = {meaning: _as_count(meaning, parameters[name]) for meaning, name in spelled.items()}
    configuration = base or MonteCarloConfiguration()
    if isinstance(most := given.get("max_particles"), int) and 0 < most < configuration.kld.particles_min:
        given.setdefault("min_particles", most)
    unused = {name for name in given if name in _IGNORED or (_is_holonomic(given) and name.startswith("odom_alpha"))}
    given = {name: value for name, value in given.items() if name not in unused}
    try:
        configuration = replace_parameters(configuration, _changes(given, configuration))
    except ConfigurationError as error:
        raise _with_amcl_name(error, spelled) from None
    if "laser_lambda_short" in given and "lambda_short_per_m" not in to_table(configuration.sensor):
        unused.add("laser_lambda_short")
    pose = None
    if given.get("set_initial_pose", any(name in given for name in _POSE)):
        pose = np.array([float(given.get(name, 0.0)) for name in _POSE])
    else:
        unused.update(name for name in given if name in _POSE or name in _COVARIANCE)
    ignored = tuple(name for meaning, name in spelled.items() if meaning in unused)
    return AmclParameters(configuration, pose, _read_covariance(given), ignored)


def read_amcl(path: str | Path, base: MonteCarloConfiguration | None = None) -> AmclParameters:
    """Read a parameter file of AMCL as it is: of ROS 1's amcl, of nav2 or of Beluga.

    In a file with the parameters of many nodes those of `amcl` are read, and before them those of all nodes (`/**`).
    `ignored` then contains the parameters that AMCL does not have, as ROS ignores them, and the names of other nodes.

    Raises
    ------
    InputError
        The file cannot be read or is no YAML, or it has no parameters of AMCL, or those of several robots.
    ConfigurationError
        A value is of a wrong type or out of range; names file and parameter.
    """
    nodes = read_parameter_file(path)
    robots = [name for name, _ in nodes if re.fullmatch("(.*[/_])?amcl", name)] or [name for name, _ in nodes][:1]
    if len(robots) > 1:
        raise InputError(path, f"expected the parameters of one node amcl, got {' and '.join(robots)}")
    everybody = [name for name, _ in nodes if name.endswith("*") and name not in robots]
    values: dict[str, Any] = {}
    for name, table in sorted(nodes, key=lambda node: node[0] in robots):
        if name in (*everybody, *robots):
            values |= {key.removeprefix("amcl."): value for key, value in table.items()}
    known = {name: value for name, value in values.items() if name in AMCL_NAMES}
    if not known:
        raise InputError(path, "expected parameters of AMCL such as max_particles, got none")
    try:
        read = from_amcl(known, base)
    except ConfigurationError as error:
        raise ConfigurationError(f"{path}: {error}") from None
    others = [name for name, _ in nodes if name not in (*robots, *everybody)]
    return read._replace(ignored=(*read.ignored, *(name for name in values if name not in known), *others))


def override_configuration(configuration: MonteCarloConfiguration, assignments: Iterable[str]) -> AmclParameters:
    """Change parameters by ``name=value``, AMCL's first and then gridslam's own (see `MonteCarloConfiguration`).

    Raises
    ------
    ConfigurationError
        An assignment is malformed, or a parameter is unknown, of a wrong type or out of range.
    """
    own = read_assignments(assignments)
    amcl = {name: own.pop(name) for name in AMCL_NAMES - to_table(configuration).keys() if name in own}
    read = from_amcl(amcl, configuration)
    return read._replace(configuration=replace_parameters(read.configuration, nest(own), AMCL_NAMES))


_AMCL_VARIANCES = 0.25, 0.25, (math.pi / 12) ** 2


def _read_covariance(given: Mapping[str, Any]) -> FloatArray:
    """Return covariance (3, 3) of the initial pose; AMCL's where none is given."""
    covariance = np.diag(_AMCL_VARIANCES)
    for name, (row, column) in _COVARIANCE.items():
        if name in given:
            covariance[row, column] = covariance[column, row] = given[name]
    if (np.linalg.eigvalsh(covariance) < 0).any():
        raise ConfigurationError(f"initial pose: expected a covariance, got {covariance.tolist()}")
    return covariance


def _check_values(parameters: Mapping[str, Any]) -> None:
    """Check that the parameters that no component takes are numbers or booleans."""
    for name, value in parameters.items():
        meaning = _ALIASES.get(name, name)
        if meaning in ("selective_resampling", "set_initial_pose") and not isinstance(value, bool):
            raise ConfigurationError(f"{name}: expected true or false, got {value!r}")
        if meaning not in (*_POSE, *_COVARIANCE, *_SHARES, *_BINS):
            continue
        row, column = _COVARIANCE.get(meaning, (0, 0))
        least = -math.inf if meaning in _POSE or row != column else 0.0
        number = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
        if not number or value < least:
            raise ConfigurationError(f"{name}: expected a number{'' if least else ' >= 0'}, got {value!r}")


def _as_count(meaning: str, value: Any) -> Any:  # noqa: ANN401
    """Convert a value as roscpp does: 500.0 is a number of particles."""
    return int(value) if meaning in _COUNTS and isinstance(value, float) and value.is_integer() else value


def _with_amcl_name(error: ConfigurationError, spelled: Mapping[str, str]) -> ConfigurationError:
    """Replace gridslam's name of a parameter by the one that was given."""
    path, _, problem = str(error).partition(": ")
    places = {**_PLACES, "laser_lambda_short": "sensor.lambda_short_per_m"}
    own = [name for meaning, name in spelled.items() if places.get(meaning, meaning) == path]
    return ConfigurationError(f"{own[0] if own else path}: {problem}")


def _changes(given: Mapping[str, Any], configuration: MonteCarloConfiguration) -> Table:
    """Return nested changes to the parts."""
    changes = _sensor(given, configuration) | _motion(given, configuration)
    for name, value in given.items():
        if name in _PLACES and not (name.endswith("_range") and value == -1):  # -1: the sensor's own
            every_scan = name.startswith("update_min_") and value == 0
            changes[_PLACES[name]] = _ALMOST_ZERO if every_scan else value
    if "selective_resampling" in given:
        selective = given["selective_resampling"]
        changes["when_to_resample.kind"] = "EffectiveSampleSizeBelow" if selective else "AlwaysResample"
    sides = [given[name] for name in _BINS[:2] if name in given]
    if sides:
        changes["kld.bin_m"] = min(sides)
    if _BINS[2] in given:
        changes["kld.bin_rad"] = given[_BINS[2]]
    return nest(changes)


def _is_holonomic(given: Mapping[str, Any]) -> bool:
    return "omni" in str(given.get("odom_model_type")).lower()


def _motion(given: Mapping[str, Any], configuration: MonteCarloConfiguration) -> Table:
    model = given.get("odom_model_type")
    if _is_holonomic(given):
        return {"motion.kind": "GMappingMotion"} if isinstance(configuration.motion, OdometryMotion) else {}
    if model is not None and "diff" not in str(model).lower():
        raise ConfigurationError(f"odom_model_type: expected diff or omni, got {model!r}")
    named = model is not None or any(name.startswith("odom_alpha") for name in given)
    return {"motion.kind": "OdometryMotion"} if named else {}


def _sensor(given: Mapping[str, Any], configuration: MonteCarloConfiguration) -> Table:
    """Return the sensor model; AMCL's shares need not sum to 1, and a factor on all of them changes nothing."""
    model = given.get("laser_model_type")
    if model not in (None, "likelihood_field", "likelihood_field_prob", "beam"):
        raise ConfigurationError(f"laser_model_type: expected likelihood_field or beam, got {model!r}")
    now = type(configuration.sensor).__name__
    kind = now if model is None else "BeamRangeFinder" if model == "beam" else "LikelihoodField"
    changes: Table = {"sensor.kind": kind} if kind != now else {}
    if any(name in given for name in _SHARES):
        before = to_table(configuration.sensor) if kind == now else {}
        used = ("z_hit", "z_short", "z_max", "z_rand") if kind == "BeamRangeFinder" else ("z_hit", "z_rand")
        amcl = AMCL_DEFAULTS["amcl"]
        shares = {place: float(given.get(name, before.get(place, amcl[name]))) for name, place in _SHARES.items()}
        total = sum(shares[place] for place in used)
        if not total:
            raise ConfigurationError(f"{' and '.join(used)}: expected a sum above 0, got none")
        changes |= {f"sensor.{place}": shares[place] / total for place in used}
        changes.setdefault("sensor.z_max", 0.0)
    if "laser_lambda_short" in given and kind == "BeamRangeFinder":
        changes["sensor.lambda_short_per_m"] = given["laser_lambda_short"]
    if given.get("laser_max_range", -1) != -1:
        changes["sensor.range_max_m"] = given["laser_max_range"]
    return changes
