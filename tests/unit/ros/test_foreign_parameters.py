"""Parameter files of slam_toolbox, nav2 and AMCL do here what they do there, or are named with the reason."""

import numpy as np
import pytest

from gridslam.config.tables import value_of
from gridslam.errors import ConfigurationError
from gridslam.io.maps import write_map
from gridslam.io.ros_parameters import read_parameter_file
from gridslam.ros.node.parameters import node_parameters
from gridslam.ros.node.ros_node import RosNode
from gridslam.ros.ros2.parameter_files import find_foreign_files
from support.localization_world import flat_map
from support.ros_node import LocalTransport

SLAM_TOOLBOX = """
slam_toolbox:
  ros__parameters:
    solver_plugin: solver_plugins::CeresSolver
    ceres_linear_solver: SPARSE_NORMAL_CHOLESKY
    ceres_loss_function: None
    odom_frame: wheel_odom
    map_frame: world
    base_frame: base_footprint
    scan_topic: /front/scan
    mode: mapping
    debug_logging: false
    throttle_scans: 2
    transform_publish_period: 0.02
    map_update_interval: 4.0
    resolution: 0.1
    min_laser_range: 0.2
    max_laser_range: 12.0
    minimum_time_interval: 0.5
    transform_timeout: 0.2
    tf_buffer_duration: 30.
    stack_size_to_use: 40000000
    enable_interactive_mode: true
    use_scan_matching: true
    use_scan_barycenter: true
    minimum_travel_distance: 0.3
    minimum_travel_heading: 0.25
    scan_buffer_size: 10
    link_match_minimum_response_fine: 0.1
    do_loop_closing: true
    loop_match_minimum_chain_size: 10
    correlation_search_space_dimension: 0.5
    loop_search_space_resolution: 0.05
    distance_variance_penalty: 0.5
    fine_search_angle_offset: 0.00349
    coarse_angle_resolution: 0.0349
    minimum_angle_penalty: 0.9
    use_response_expansion: true
    min_pass_through: 2
    occupancy_threshold: 0.1
"""

AMCL = """
amcl:
  ros__parameters:
    mode: localization
    yaml_filename: {map}
    base_frame_id: base_footprint
    odom_frame_id: wheel_odom
    global_frame_id: map
    scan_topic: front/scan
    transform_tolerance: 1.0
    max_particles: 900
    min_particles: 300
    robot_model_type: "nav2_amcl::DifferentialMotionModel"
    set_initial_pose: true
    initial_pose:
      x: 1.5
      y: 2.5
      z: 0.0
      yaw: 0.5
map_server:
  ros__parameters:
    yaml_filename: another.yaml
"""


@pytest.fixture
def slam_toolbox(tmp_path):
    (tmp_path / "mapper.yaml").write_text(SLAM_TOOLBOX)
    return tmp_path / "mapper.yaml"


@pytest.fixture
def amcl(tmp_path):
    write_map(tmp_path / "flat.yaml", flat_map())
    (tmp_path / "nav2.yaml").write_text(AMCL.format(map=tmp_path / "flat.yaml"))
    return tmp_path / "nav2.yaml"


def test_a_file_of_slam_toolbox_is_understood(slam_toolbox):
    ((_, given),) = read_parameter_file(slam_toolbox)
    found = node_parameters(given, "default")
    settings, configuration = found.settings, found.configuration
    assert (settings.odom_frame, settings.map_frame, settings.base_frame) == ("wheel_odom", "world", "base_footprint")
    assert (settings.transform_wait_s, settings.map_update_interval_s, settings.throttle_scans) == (0.2, 4.0, 2)
    assert (settings.transform_publish_period_s, settings.scan_topic) == (0.02, "/front/scan")
    for path, value in (
        ("mapper.resolution_m", 0.1),
        ("range_min_m", 0.2),
        ("range_max_m", 12.0),
        ("when_to_update.translation_m", 0.3),
        ("when_to_update.rotation_rad", 0.25),
    ):
        assert value_of(configuration, path) == value
    assert configuration.loop_closure is not None
    assert "there is no such parameter" not in found.warning
    assert "solver_plugin, ceres_linear_solver, ceres_loss_function (the pose graph has a solver" in found.warning
    assert "minimum_time_interval (every scan is tracked)" in found.warning
    assert "resolution" not in found.warning.replace("coarse_angle_resolution", "").replace("space_resolution", "")


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"resolution": 0.0}, "^resolution: expected a number greater than or equal to 0.01"),
        ({"resolution": "fine"}, "^resolution: expected a"),
        ({"transform_timeout": -0.1}, "^transform_timeout: expected a number greater than or equal to 0"),
        ({"minimum_travel_distance": "far"}, "^minimum_travel_distance: expected a"),
        ({"do_loop_closing": 1}, "^do_loop_closing: expected true or false, got 1"),
        ({"min_laser_range": "near"}, "^min_laser_range: expected a number, got 'near'"),
        ({"scan_topic": 3}, "^scan_topic: expected a valid string, got 3"),
    ],
)
def test_wrong_values_are_named_as_they_were_given(given, says):
    with pytest.raises(ConfigurationError, match=says):
        node_parameters(given, "default")


def test_a_file_of_nav2_places_the_robot(amcl):
    arguments = ["--ros-args", "-r", "__node:=amcl", "--params-file", str(amcl)]
    assert find_foreign_files(arguments, "/amcl") == ()
    found = node_parameters(dict(read_parameter_file(amcl))["/amcl"], "default")
    pose, _ = found.configuration.initial_pose
    np.testing.assert_array_equal(pose, [1.5, 2.5, 0.5])
    assert found.configuration.configuration.kld.particles_max == 900
    assert (found.settings.scan_topic, found.settings.tf_delay_s) == ("front/scan", 1.0)
    assert "scan_topic" not in found.warning


def test_a_file_for_another_node_is_named_in_one_line(slam_toolbox, amcl, tmp_path):
    (tmp_path / "flat_parameters.yaml").write_text("resolution: 0.1\n")
    (tmp_path / "all.yaml").write_text("/**:\n  ros__parameters: {resolution: 0.1}\n")
    files = [str(slam_toolbox), str(amcl), str(tmp_path / "flat_parameters.yaml"), str(tmp_path / "all.yaml")]
    arguments = [part for path in files for part in ("--params-file", path)]
    one, two, three = find_foreign_files(arguments, "/gridslam")
    assert one == (
        f"{files[0]} has parameters of /slam_toolbox, none of /gridslam, so nothing in it is used: "
        "start with -r __node:=slam_toolbox, or rename the node in it"
    )
    assert "has parameters of /amcl, /map_server, none of /gridslam" in two
    assert "names no node" in three


def test_the_scans_come_from_the_topic_that_is_given():
    subscribed = []

    class Transport(LocalTransport):
        def subscribe(self, topic, kind, handle, **qos):
            subscribed.append(topic)

    node = RosNode(Transport(), node_parameters({"scan_topic": "front"}, "default"))
    node.start()
    assert "front" in subscribed
    assert "scan" not in subscribed
    node.close()
