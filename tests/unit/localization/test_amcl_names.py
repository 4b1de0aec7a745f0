"""AMCL's parameters: every one is known, what it means here, and what is refused."""

import math

import pytest

from gridslam.api.amcl import AMCL_DEFAULTS, from_amcl, read_amcl
from gridslam.errors import ConfigurationError, InputError
from gridslam.models.endpoint import LikelihoodField
from gridslam.models.motion import OdometryMotion
from gridslam.particles.policies import AlwaysResample


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


ROS_1 = """
odom_model_type: diff-corrected
odom_alpha1: 0.3
min_particles: 500
max_particles: 3000
kld_err: 0.02
laser_max_beams: 60
laser_z_hit: 0.95
laser_z_rand: 0.05
recovery_alpha_fast: 0.
initial_pose_x: 1.0
initial_cov_aa: 0.02
gui_publish_rate: 10.0
"""
NAV2 = """
amcl:
  ros__parameters:
    use_sim_time: True
    alpha1: 0.3
    kernel: 5
    max_beams: 60
    max_particles: 3000
    min_particles: 500
    pf_err: 0.02
    robot_model_type: "nav2_amcl::DifferentialMotionModel"
    z_hit: 0.95
    z_rand: 0.05
    set_initial_pose: true
    initial_pose: {x: 1.0, y: 0.0, z: 0.0, yaw: 0.0}
    qos_overrides: {/scan: {subscription: {depth: 5}}}
amcl_map_client:
  ros__parameters: {use_sim_time: True}
local_costmap:
  local_costmap:
    ros__parameters: {width: 3}
"""
BELUGA = """
/**:
  ros__parameters: {max_beams: 10, pf_err: 0.02}
amcl:
  ros__parameters:
    robot_model_type: differential_drive
    alpha1: 0.3
    max_beams: 60
    max_particles: 3000
    min_particles: 500
    z_hit: 0.95
    z_rand: 0.05
    execution_policy: par
    initial_pose.x: 1.0
"""


def test_files_of_ros_1_nav2_and_beluga_mean_the_same(tmp_path):
    """The three files state the same filter, each by its own names and nested in its own way."""
    reads = {}
    for name, text in (("ros1", ROS_1), ("nav2", NAV2), ("beluga", BELUGA)):
        (tmp_path / name).write_text(text)
        reads[name] = read_amcl(tmp_path / name)
        assert reads[name].pose.tolist() == [1, 0, 0]
    ros_1, nav2, beluga = (read.configuration for read in reads.values())
    assert ros_1.motion == OdometryMotion(alpha1=0.3)
    assert (ros_1.kld.particles_min, ros_1.kld.particles_max, ros_1.kld.error, ros_1.max_beams) == (500, 3000, 0.02, 60)
    assert ros_1.recovery.alpha_fast == 0
    assert (nav2.motion, nav2.kld, nav2.max_beams, nav2.sensor) == (
        ros_1.motion,
        ros_1.kld,
        ros_1.max_beams,
        ros_1.sensor,
    )
    assert (beluga.kld.error, beluga.max_beams) == (0.02, 60)
    assert reads["ros1"].covariance[2, 2] == 0.02
    assert reads["ros1"].ignored == ("gui_publish_rate",)
    assert reads["nav2"].ignored == (
        "use_sim_time",
        "kernel",
        "initial_pose.z",
        "/amcl_map_client",
        "/local_costmap/local_costmap",
    )
    assert reads["beluga"].ignored == ("execution_policy",)


@pytest.mark.parametrize(
    ("text", "error", "said"),
    [
        ("max_particles: many", ConfigurationError, r"amcl\.yaml: max_particles: expected a valid integer, got 'many'"),
        ("amcl: {ros__parameters: 5}", InputError, r"amcl\.yaml: expected parameters below ros__parameters of /amcl"),
        ("a: 1\nb: [", InputError, r"amcl\.yaml, line \d: expected 'name: value' in YAML"),
        ("max_particles = 5", InputError, "expected 'name: value' in YAML, got 'max_particles = 5'"),
        ("controller: {ros__parameters: {rate: 5}}", InputError, "expected parameters of AMCL such as max_particles"),
        (
            "/a/amcl: {ros__parameters: {pf_z: 1}}\n/b/amcl: {ros__parameters: {pf_z: 1}}",
            InputError,
            "expected the parameters of one node amcl, got /a/amcl and /b/amcl",
        ),
    ],
)
def test_files_that_are_refused(tmp_path, text, error, said):
    (tmp_path / "amcl.yaml").write_text(text)
    with pytest.raises(error, match=said):
        read_amcl(tmp_path / "amcl.yaml")


@pytest.mark.parametrize(
    ("parameters", "said"),
    [
        ({"min_particles": 0}, "^min_particles: expected a number greater than or equal to 1, got 0"),
        ({"robot_model_type": "stationary"}, "^robot_model_type: expected one of diff, .*, got 'stationary'"),
        ({"selective_resampling": "no"}, "selective_resampling: expected one of False, True, got 'no'"),
        ({"laser_model_type": "magic"}, "laser_model_type: expected one of likelihood_field"),
        ({"sigma_hit": -1.0}, "^sigma_hit: expected a number"),
        ({"min_particles": 9000, "max_particles": 100}, "particles_min must not exceed"),
        ({"initial_pose_x": "abc"}, "initial_pose_x: expected a valid number, got 'abc'"),
        ({"initial_pose.yaw": math.nan}, "initial_pose.yaw: expected a valid number, got nan"),
        ({"initial_cov_xx": -1}, "initial_cov_xx: expected a number greater than or equal to 0, got -1"),
        ({"laser_z_hit": "abc"}, "laser_z_hit: expected a valid number, got 'abc'"),
        ({"z_rand": True}, "z_rand: expected a valid number, got True"),
        ({"laser_z_short": -0.1}, "laser_z_short: expected a number greater than or equal to 0, got -0.1"),
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
