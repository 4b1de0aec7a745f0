"""AMCL's parameters: every one is known, what it means here, and what is refused."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gridslam.api.amcl import AMCL_DEFAULTS, AMCL_NAMES, from_amcl, override_configuration
from gridslam.errors import ConfigurationError
from gridslam.localization import MonteCarloConfiguration
from gridslam.models.beam import BeamRangeFinder
from gridslam.models.endpoint import LikelihoodField
from gridslam.models.motion import OdometryMotion
from gridslam.particles.policies import AlwaysResample, EffectiveSampleSizeBelow


def test_defaults_of_ros_1():
    configuration = from_amcl(AMCL_DEFAULTS["amcl"]).configuration
    assert (
        configuration.kld.particles_min,
        configuration.kld.particles_max,
        configuration.kld.error,
        configuration.kld.z,
    ) == (100, 5000, 0.01, 0.99)
    assert configuration.motion == OdometryMotion(alpha1=0.2, alpha2=0.2, alpha3=0.2, alpha4=0.2)
    assert isinstance(configuration.sensor, LikelihoodField)
    assert (configuration.sensor.z_hit, configuration.sensor.z_rand, configuration.sensor.sigma_hit_m) == (
        0.95,
        0.05,
        0.2,
    )
    assert (configuration.when_to_update.translation_m, configuration.when_to_update.rotation_rad) == (0.2, math.pi / 6)
    assert (configuration.resample_interval, configuration.max_beams, configuration.reach_m) == (2, 30, 2.0)
    assert (configuration.recovery.alpha_slow, configuration.recovery.alpha_fast) == (0.0, 0.0)
    assert isinstance(configuration.when_to_resample, AlwaysResample)


def test_defaults_of_nav2():
    configuration = from_amcl(AMCL_DEFAULTS["nav2"]).configuration
    assert (configuration.kld.particles_min, configuration.kld.particles_max, configuration.kld.error) == (
        500,
        2000,
        0.05,
    )
    assert (
        configuration.sensor.z_hit,
        configuration.sensor.z_rand,
        configuration.max_beams,
        configuration.range_max_m,
    ) == (0.5, 0.5, 60, 100.0)


def test_both_spellings_mean_the_same():
    ros1 = from_amcl({"kld_err": 0.02, "odom_alpha3": 0.1, "laser_z_hit": 0.8, "laser_z_rand": 0.4})
    nav2 = from_amcl({"pf_err": 0.02, "alpha3": 0.1, "z_hit": 0.8, "z_rand": 0.4})
    assert ros1.configuration == nav2.configuration
    assert ros1.configuration.sensor.z_hit == pytest.approx(2 / 3)
    assert ros1.configuration.motion == OdometryMotion(alpha3=0.1)


def test_what_is_not_said_stays():
    base = MonteCarloConfiguration(max_beams=33)
    assert from_amcl({}, base).configuration == base
    assert from_amcl({"min_particles": 50}, base).configuration.max_beams == 33
    assert from_amcl({"laser_min_range": -1, "laser_max_range": -1.0}, base).configuration == base


def test_the_beam_model():
    sensor = from_amcl(
        {"laser_model_type": "beam", "laser_lambda_short": 0.3, "laser_sigma_hit": 0.15}
    ).configuration.sensor
    assert isinstance(sensor, BeamRangeFinder)
    assert (sensor.lambda_short_per_m, sensor.sigma_hit_m) == (0.3, 0.15)
    assert sensor.z_hit + sensor.z_short + sensor.z_max + sensor.z_rand == pytest.approx(1)


def test_an_initial_pose():
    read = from_amcl({"initial_pose_x": 1, "initial_pose_a": 0.5, "initial_cov_aa": 0.01})
    assert read.pose.tolist() == [1, 0, 0.5]
    np.testing.assert_allclose(np.diag(read.covariance), [0.25, 0.25, 0.01])
    assert from_amcl({"initial_pose.yaw": 2}).pose.tolist() == [0, 0, 2]
    assert from_amcl({"max_particles": 900}).pose is None


def test_what_means_nothing_here_is_named():
    read = from_amcl({"transform_tolerance": 0.2, "alpha5": 0.1, "laser_lambda_short": 0.2, "max_beams": 10})
    assert set(read.ignored) == {"transform_tolerance", "alpha5", "laser_lambda_short"}
    assert from_amcl({"selective_resampling": True}).configuration.when_to_resample == EffectiveSampleSizeBelow()


@pytest.mark.parametrize(
    ("parameters", "said"),
    [
        ({"min_particle": 3}, "did you mean min_particles"),
        ({"min_particles": 0}, "kld.particles_min: expected a number greater than or equal to 1, got 0"),
        ({"odom_model_type": "omni"}, "differential"),
        ({"laser_model_type": "magic"}, "likelihood_field or beam"),
        ({"laser_sigma_hit": -1.0}, "sensor.sigma_hit_m"),
        ({"min_particles": 9000, "max_particles": 100}, "particles_min must not exceed"),
        ({"initial_pose_x": "abc"}, "initial_pose_x: expected a number, got 'abc'"),
        ({"initial_pose.yaw": math.nan}, "initial_pose.yaw: expected a number, got nan"),
        ({"initial_cov_xx": -1}, "initial_cov_xx: expected a number >= 0, got -1"),
        ({"laser_z_hit": "abc"}, "laser_z_hit: expected a number >= 0, got 'abc'"),
        ({"z_rand": True}, "z_rand: expected a number >= 0, got True"),
        ({"laser_z_short": -0.1}, "laser_z_short: expected a number >= 0, got -0.1"),
        ({"laser_min_range": 2, "laser_max_range": 1.5}, "range_min_m must be less than range_max_m"),
        (
            {"laser_likelihood_max_dist": 0.1, "laser_sigma_hit": 0.2},
            "reach_m must not be less than sensor.sigma_hit_m",
        ),
        ({"laser_z_hit": 0, "z_rand": 0}, "z_hit and z_rand: expected a sum above 0"),
    ],
)
def test_what_is_refused(parameters, said):
    with pytest.raises(ConfigurationError, match=said):
        from_amcl(parameters)


def test_every_default_is_a_known_name():
    assert all(set(defaults) <= AMCL_NAMES for defaults in AMCL_DEFAULTS.values())


def test_assignments_by_both_kinds_of_names():
    read = override_configuration(
        MonteCarloConfiguration(),
        ["laser_max_beams=40", "kld.z=1.5", "sensor.sigma_hit_m=0.07", "initial_pose_x=3", "tf_broadcast=true"],
    )
    assert (read.configuration.max_beams, read.configuration.kld.z, read.configuration.sensor.sigma_hit_m) == (
        40,
        1.5,
        0.07,
    )
    assert read.pose.tolist() == [3, 0, 0]
    assert read.ignored == ("tf_broadcast",)
    kind = override_configuration(
        MonteCarloConfiguration(), ["motion.kind=OdometryMotion", "motion.alpha1=0.3", "max_beams=9"]
    )
    assert kind.configuration.motion == OdometryMotion(alpha1=0.3)
    assert kind.configuration.max_beams == 9
    for wrong, said in (("max_beams", "name=value"), ("sensor.sigma=1", "sigma"), ("nonsense=1", "no such parameter")):
        with pytest.raises(ConfigurationError, match=said):
            override_configuration(MonteCarloConfiguration(), [wrong])
