"""Parameters of localization by name: AMCL's, of ROS 1 and of nav2, and gridslam's own."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any, Final, NamedTuple, final

import numpy as np

from gridslam.config.tables import Table, nest, read_assignments, replace_parameters, suggest_names, to_table
from gridslam.errors import ConfigurationError
from gridslam.localization.monte_carlo import MonteCarloConfiguration
from gridslam.types import FloatArray

__all__ = ["AMCL_DEFAULTS", "AMCL_NAMES", "AmclParameters", "from_amcl", "override_configuration"]

AMCL_DEFAULTS: Final[Mapping[str, Mapping[str, Any]]] = {
    "amcl": {
        "min_particles": 100,
        "max_particles": 5000,
        "kld_err": 0.01,
        "kld_z": 0.99,
        "update_min_d": 0.2,
        "update_min_a": math.pi / 6,
        "resample_interval": 2,
        "recovery_alpha_slow": 0.0,
        "recovery_alpha_fast": 0.0,
        "odom_alpha1": 0.2,
        "odom_alpha2": 0.2,
        "odom_alpha3": 0.2,
        "odom_alpha4": 0.2,
        "laser_max_beams": 30,
        "laser_z_hit": 0.95,
        "laser_z_short": 0.1,
        "laser_z_max": 0.05,
        "laser_z_rand": 0.05,
        "laser_sigma_hit": 0.2,
        "laser_lambda_short": 0.1,
        "laser_likelihood_max_dist": 2.0,
        "laser_model_type": "likelihood_field",
        "odom_model_type": "diff",
        "selective_resampling": False,
    },
    "nav2": {
        "min_particles": 500,
        "max_particles": 2000,
        "pf_err": 0.05,
        "pf_z": 0.99,
        "update_min_d": 0.25,
        "update_min_a": 0.2,
        "resample_interval": 1,
        "recovery_alpha_slow": 0.0,
        "recovery_alpha_fast": 0.0,
        "alpha1": 0.2,
        "alpha2": 0.2,
        "alpha3": 0.2,
        "alpha4": 0.2,
        "max_beams": 60,
        "z_hit": 0.5,
        "z_short": 0.05,
        "z_max": 0.05,
        "z_rand": 0.5,
        "sigma_hit": 0.2,
        "lambda_short": 0.1,
        "laser_likelihood_max_dist": 2.0,
        "laser_max_range": 100.0,
        "laser_model_type": "likelihood_field",
        "robot_model_type": "nav2_amcl::DifferentialMotionModel",
    },
}
"""The defaults of ROS 1's amcl and of nav2's, each by its own names."""

_NAV2: Final[Mapping[str, str]] = {
    "pf_err": "kld_err",
    "pf_z": "kld_z",
    "alpha1": "odom_alpha1",
    "alpha2": "odom_alpha2",
    "alpha3": "odom_alpha3",
    "alpha4": "odom_alpha4",
    "alpha5": "odom_alpha5",
    "max_beams": "laser_max_beams",
    "z_hit": "laser_z_hit",
    "z_short": "laser_z_short",
    "z_max": "laser_z_max",
    "z_rand": "laser_z_rand",
    "sigma_hit": "laser_sigma_hit",
    "lambda_short": "laser_lambda_short",
    "robot_model_type": "odom_model_type",
    "initial_pose.x": "initial_pose_x",
    "initial_pose.y": "initial_pose_y",
    "initial_pose.yaw": "initial_pose_a",
}
_PLACES: Final[Mapping[str, str]] = {
    "min_particles": "kld.particles_min",
    "max_particles": "kld.particles_max",
    "kld_err": "kld.error",
    "kld_z": "kld.z",
    "update_min_d": "when_to_update.translation_m",
    "update_min_a": "when_to_update.rotation_rad",
    "resample_interval": "resample_interval",
    "recovery_alpha_slow": "recovery.alpha_slow",
    "recovery_alpha_fast": "recovery.alpha_fast",
    "odom_alpha1": "motion.alpha1",
    "odom_alpha2": "motion.alpha2",
    "odom_alpha3": "motion.alpha3",
    "odom_alpha4": "motion.alpha4",
    "laser_max_beams": "max_beams",
    "laser_min_range": "range_min_m",
    "laser_max_range": "range_max_m",
    "laser_sigma_hit": "sensor.sigma_hit_m",
    "laser_likelihood_max_dist": "reach_m",
}
_SHARES = {f"laser_z_{kind}": f"z_{kind}" for kind in ("hit", "short", "max", "rand")}
_POSE = ("initial_pose_x", "initial_pose_y", "initial_pose_a")
_COVARIANCE = ("initial_cov_xx", "initial_cov_yy", "initial_cov_aa")
_DECIDES = ("laser_model_type", "odom_model_type", "selective_resampling", "laser_lambda_short")
_IGNORED = (
    "odom_alpha5",
    "do_beamskip",
    "beam_skip_distance",
    "beam_skip_threshold",
    "beam_skip_error_threshold",
    "base_frame_id",
    "odom_frame_id",
    "global_frame_id",
    "tf_broadcast",
    "transform_tolerance",
    "gui_publish_rate",
    "save_pose_rate",
    "use_map_topic",
    "first_map_only",
    "set_initial_pose",
    "always_reset_initial_pose",
    "scan_topic",
    "map_topic",
    "initial_pose.z",
    "use_sim_time",
)

AMCL_NAMES: Final = frozenset((*_PLACES, *_SHARES, *_POSE, *_COVARIANCE, *_DECIDES, *_IGNORED, *_NAV2))
"""Every name that `from_amcl` knows."""


@final
class AmclParameters(NamedTuple):
    """What AMCL's parameters mean here.

    Attributes
    ----------
    configuration : MonteCarloConfiguration
    pose : (3,) float64 or None
        Initial pose, where one of its coordinates is given.
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
    """Read AMCL's parameters, by the names of ROS 1 or nav2; parameters that are not given stay as in `base`.

    Parameters
    ----------
    parameters : mapping of str to object
        For all of AMCL's defaults begin with `AMCL_DEFAULTS`.
    base : MonteCarloConfiguration, optional
        The defaults of gridslam if not given.

    Raises
    ------
    ConfigurationError
        A name is unknown, a value is of a wrong type or out of range, or the robot is holonomic ("omni").
    """
    unknown = [name for name in parameters if name not in AMCL_NAMES]
    if unknown:
        raise ConfigurationError(f"{unknown[0]}: AMCL has no such parameter{suggest_names(unknown[0], AMCL_NAMES)}")
    _check_numbers(parameters)
    given = {_NAV2.get(name, name): value for name, value in parameters.items()}
    configuration = base or MonteCarloConfiguration()
    if isinstance(most := given.get("max_particles"), int) and 0 < most < configuration.kld.particles_min:
        given.setdefault("min_particles", most)
    configuration = replace_parameters(configuration, _changes(given, configuration))
    ignored = [name for name in parameters if _NAV2.get(name, name) in _IGNORED]
    if "laser_lambda_short" in given and "lambda_short_per_m" not in to_table(configuration.sensor):
        ignored.append("lambda_short" if "lambda_short" in parameters else "laser_lambda_short")
    pose = np.array([float(given.get(name, 0.0)) for name in _POSE]) if any(name in given for name in _POSE) else None
    variances = (float(given.get(name, default)) for name, default in zip(_COVARIANCE, _AMCL_VARIANCES, strict=True))
    return AmclParameters(configuration, pose, np.diag(list(variances)), tuple(ignored))


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


def _check_numbers(parameters: Mapping[str, Any]) -> None:
    """Refuse what is no number among the parameters that are not handed on to a part, which checks its own."""
    for name, value in parameters.items():
        meaning = _NAV2.get(name, name)
        least = -math.inf if meaning in _POSE else 0.0
        if meaning not in (*_POSE, *_COVARIANCE, *_SHARES):
            continue
        number = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
        if not number or value < least:
            raise ConfigurationError(f"{name}: expected a number{'' if least else ' >= 0'}, got {value!r}")


def _changes(given: Mapping[str, Any], configuration: MonteCarloConfiguration) -> Table:
    """Nested changes to the parts."""
    changes = _sensor(given, configuration) | _motion(given)
    for name, value in given.items():
        if name in _PLACES and not (name.endswith("_range") and value == -1):  # -1: the sensor's own
            changes[_PLACES[name]] = value
    if "selective_resampling" in given:
        selective = given["selective_resampling"]
        changes["when_to_resample.kind"] = "EffectiveSampleSizeBelow" if selective else "AlwaysResample"
    return nest(changes)


def _motion(given: Mapping[str, Any]) -> Table:
    model = str(given.get("odom_model_type", "diff"))
    if "omni" in model.lower():
        raise ConfigurationError(f"odom_model_type: expected a differential drive, got {model}")
    named = "odom_model_type" in given or any(name.startswith("odom_alpha") for name in given)
    return {"motion.kind": "OdometryMotion"} if named else {}


def _sensor(given: Mapping[str, Any], configuration: MonteCarloConfiguration) -> Table:
    """The sensor model; AMCL's shares need not sum to 1, and a factor on all of them changes nothing."""
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
