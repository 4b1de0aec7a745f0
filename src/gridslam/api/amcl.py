"""Parameters of localization by name: AMCL's, of ROS 1 and of nav2, and gridslam's own."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final, NamedTuple, final

import numpy as np

from gridslam.config.tables import names, nest, read_assignments, replace_parameters
from gridslam.errors import ConfigurationError, InputError
from gridslam.io.ros_parameters import read_parameter_file
from gridslam.localization.monte_carlo import MonteCarloConfiguration
from gridslam.parameters import Table, bounded, parameters, to_table
from gridslam.types import FloatArray

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
    ("laser_max_beams", "max_beams", 30, 60, "max_beams"),
    ("laser_z_hit", "z_hit", 0.95, 0.5, ""),
    ("laser_z_short", "z_short", 0.1, 0.05, ""),
    ("laser_z_max", "z_max", 0.05, 0.05, ""),
    ("laser_z_rand", "z_rand", 0.05, 0.5, ""),
    ("laser_sigma_hit", "sigma_hit", 0.2, 0.2, "sensor.sigma_hit_m"),
    ("laser_lambda_short", "lambda_short", 0.1, 0.1, "sensor.lambda_short_per_m"),
    ("laser_likelihood_max_dist", "", 2.0, 2.0, "reach_m"),
    ("laser_min_range", "", None, None, "range_min_m"),
    ("laser_max_range", "", None, 100.0, "range_max_m"),
    ("laser_model_type", "", "likelihood_field", "likelihood_field", "sensor.kind"),
    ("odom_model_type", "robot_model_type", "diff", "nav2_amcl::DifferentialMotionModel", "motion.kind"),
    ("selective_resampling", "", False, None, "when_to_resample.kind"),
)
"""AMCL's parameters: the name in ROS 1, another one in nav2, the defaults in both, and the parameter here if any."""

_KINDS: Final[Mapping[str, Mapping[str, str]]] = {
    "laser_model_type": {
        "likelihood_field": "LikelihoodField",
        "likelihood_field_prob": "LikelihoodField",
        "beam": "BeamRangeFinder",
    },
    "odom_model_type": {
        "diff": "OdometryMotion",
        "diff-corrected": "OdometryMotion",
        "differential": "OdometryMotion",
        "differential_drive": "OdometryMotion",
        "nav2_amcl::DifferentialMotionModel": "OdometryMotion",
        "omni": "GMappingMotion",
        "omni-corrected": "GMappingMotion",
        "omnidirectional": "GMappingMotion",
        "omnidirectional_drive": "GMappingMotion",
        "nav2_amcl::OmniMotionModel": "GMappingMotion",
    },
    "selective_resampling": {"False": "AlwaysResample", "True": "EffectiveSampleSizeBelow"},
}
"""Parts by the values of parameters; a holonomic robot's motion has noise across it, too."""

AMCL_DEFAULTS: Final[Mapping[str, Mapping[str, Any]]] = {
    "amcl": {name: default for name, _, default, _, _ in _TABLE if default is not None},
    "nav2": {other or name: default for name, other, _, default, _ in _TABLE if default is not None},
}
"""The defaults of ROS 1's amcl and of nav2's, each by its own names."""

_ALIASES: Final[Mapping[str, str]] = {
    **{other: name for name, other, *_ in _TABLE if other},
    "initial_pose.x": "initial_pose_x",
    "initial_pose.y": "initial_pose_y",
    "initial_pose.yaw": "initial_pose_a",
    "initial_pose_yaw": "initial_pose_a",
}
_PLACES: Final = {name: place for name, *_, place in _TABLE if place}
_POSE: Final = ("initial_pose_x", "initial_pose_y", "initial_pose_a")
_SHARES: Final = ("z_hit", "z_short", "z_max", "z_rand")
_COUNTS: Final = ("min_particles", "max_particles", "resample_interval", "laser_max_beams")
_ALMOST_ZERO = 1e-9
_IGNORED: Final = frozenset(
    """
    odom_alpha5 do_beamskip beam_skip_distance beam_skip_threshold beam_skip_error_threshold base_frame_id
    odom_frame_id global_frame_id tf_broadcast transform_tolerance gui_publish_rate save_pose_rate use_map_topic
    first_map_only always_reset_initial_pose scan_topic map_topic map_service initial_pose.z initial_pose_topic
    use_sim_time execution_policy model_unknown_space freespace_downsampling random_seed restore_defaults
    bond_heartbeat_period introspection_mode force_update_after_initialpose force_update_after_set_map
    std_warn_level_x std_warn_level_y std_warn_level_yaw
    """.split()  # noqa: SIM905 one name a line would be half a page
)


@final
@parameters(frozen=True)
class _Rest:
    """AMCL's parameters that are none of the filter: the initial pose with its variances, and the sensor's shares."""

    set_initial_pose: bool = True
    initial_pose_x: float = 0.0
    initial_pose_y: float = 0.0
    initial_pose_a: float = 0.0
    initial_cov_xx: float = bounded(0.25, ge=0)
    initial_cov_yy: float = bounded(0.25, ge=0)
    initial_cov_aa: float = bounded((math.pi / 12) ** 2, ge=0)
    laser_z_hit: float = bounded(0.95, ge=0)
    laser_z_short: float = bounded(0.1, ge=0)
    laser_z_max: float = bounded(0.05, ge=0)
    laser_z_rand: float = bounded(0.05, ge=0)


AMCL_NAMES: Final = frozenset((*(name for name, *_ in _TABLE), *_ALIASES, *names(_Rest()), *_IGNORED))
"""The names of AMCL's parameters."""


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
        Names that mean nothing here.
    """

    configuration: MonteCarloConfiguration
    pose: FloatArray | None
    covariance: FloatArray
    ignored: tuple[str, ...]


def from_amcl(parameters: Mapping[str, Any], base: MonteCarloConfiguration | None = None) -> AmclParameters:
    """Read AMCL's parameters, by the names of ROS 1 or nav2; parameters that are not given stay as in `base`.

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
        A value is of a wrong type or out of range.
    """
    spelled = {_ALIASES.get(name, name): name for name in parameters}
    given = {meaning: _as_count(meaning, parameters[name]) for meaning, name in spelled.items()}
    configuration = base or MonteCarloConfiguration()
    is_holonomic = _KINDS["odom_model_type"].get(str(given.get("odom_model_type"))) == "GMappingMotion"
    unused = {name for name in given if is_holonomic and name.startswith("odom_alpha")}
    if isinstance(most := given.get("max_particles"), int) and 0 < most < configuration.kld.particles_min:
        given.setdefault("min_particles", most)
    try:
        rest = replace_parameters(_Rest(), {name: given[name] for name in names(_Rest()) if name in given})
        used = {name: value for name, value in given.items() if name not in unused}
        changes = _changes(used, rest, configuration)
        configuration = replace_parameters(configuration, nest(changes))
    except ConfigurationError as error:
        raise _with_amcl_name(error, spelled) from None
    pose = None
    if rest.set_initial_pose and any(name in given for name in ("set_initial_pose", *_POSE)):
        pose = np.array([rest.initial_pose_x, rest.initial_pose_y, rest.initial_pose_a])
    else:
        unused |= {name for name in given if name.startswith(("initial_pose", "initial_cov"))}
    covariance = np.diag([rest.initial_cov_xx, rest.initial_cov_yy, rest.initial_cov_aa])
    unused |= given.keys() - AMCL_NAMES | _IGNORED & given.keys()
    ignored = tuple(name for meaning, name in spelled.items() if meaning in unused)
    return AmclParameters(configuration, pose, covariance, ignored)


def read_amcl(path: str | Path, base: MonteCarloConfiguration | None = None) -> AmclParameters:
    """Read a parameter file of AMCL as it is: of ROS 1's amcl, of nav2 or of Beluga.

    In a file with the parameters of many nodes those of `amcl` are read, and before them those of all nodes (`/**`).
    `ignored` then contains the names of other nodes, too.

    Raises
    ------
    InputError
        The file cannot be read or is no YAML, or it has no parameters of AMCL, or those of several robots.
    ConfigurationError
        A value is of a wrong type or out of range; names file and parameter.
    """
    nodes = read_parameter_file(path)
    robots = [name for name, _ in nodes if name.endswith("amcl")] or [nodes[0][0]]
    if len(robots) > 1:
        raise InputError(path, f"expected the parameters of one node amcl, got {' and '.join(robots)}")
    values: dict[str, Any] = {}
    others = []
    for name, table in sorted(nodes, key=lambda node: node[0] in robots):
        if name in robots or name.endswith("*"):
            values |= {key.removeprefix("amcl."): value for key, value in table.items()}
        else:
            others.append(name)
    if not AMCL_NAMES & values.keys():
        raise InputError(path, "expected parameters of AMCL such as max_particles, got none")
    try:
        read = from_amcl(values, base)
    except ConfigurationError as error:
        raise ConfigurationError(f"{path}: {error}") from None
    return read._replace(ignored=(*read.ignored, *others))


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


def _as_count(meaning: str, value: Any) -> Any:  # noqa: ANN401
    """Convert a value as roscpp does: 500.0 is a number of particles."""
    return int(value) if meaning in _COUNTS and isinstance(value, float) and value.is_integer() else value


def _with_amcl_name(error: ConfigurationError, spelled: Mapping[str, str]) -> ConfigurationError:
    """Replace gridslam's name of a parameter by the one that was given."""
    path, _, problem = str(error).partition(": ")
    own = [name for meaning, name in spelled.items() if path in (meaning, _PLACES.get(meaning))]
    return ConfigurationError(f"{own[0] if own else path}: {problem}")


def _changes(given: Mapping[str, Any], rest: _Rest, configuration: MonteCarloConfiguration) -> Table:
    """Return the changes to the filter, by dotted names."""
    changes: Table = {}
    if any(name.startswith("odom_alpha") for name in given):
        changes["motion.kind"] = "OdometryMotion"
    for name, place in _PLACES.items():
        if name in given:
            value = given[name]
            if name in _KINDS:
                kinds = _KINDS[name]
                if str(value) not in kinds:
                    raise ConfigurationError(f"{name}: expected one of {', '.join(kinds)}, got {value!r}")
                value = kinds[str(value)]
            elif name.startswith("update_min_") and value == 0:
                value = _ALMOST_ZERO
            elif name.endswith("_range") and value == -1:  # the laser's own
                continue
            changes[place] = value
    if "range_max_m" in changes:
        changes["sensor.range_max_m"] = changes["range_max_m"]
    return changes | _sensor(given, rest, changes, configuration)


def _sensor(given: Mapping[str, Any], rest: _Rest, changes: Table, configuration: MonteCarloConfiguration) -> Table:
    """Return the shares of the sensor model; AMCL's need not sum to 1, and a factor on all of them changes nothing."""
    now = type(configuration.sensor).__name__
    kind = changes.get("sensor.kind", now)
    used = _SHARES if kind == "BeamRangeFinder" else ("z_hit", "z_rand")
    if kind != "BeamRangeFinder":
        changes.pop("sensor.lambda_short_per_m", None)
    if not any(f"laser_{share}" in given for share in _SHARES):
        return {}
    own = rest.laser_z_hit, rest.laser_z_short, rest.laser_z_max, rest.laser_z_rand
    amcl = dict(zip(_SHARES, own, strict=True))
    before = to_table(configuration.sensor) if kind == now else amcl
    shares = {share: (amcl if f"laser_{share}" in given else before)[share] for share in used}
    total = sum(shares.values())
    if not total:
        raise ConfigurationError(f"{' and '.join(used)}: expected a sum above 0, got none")
    return {"sensor.z_max": 0.0} | {f"sensor.{share}": value / total for share, value in shares.items()}
