"""Parameter files of AMCL do here what they do there; files for another node are named."""

import numpy as np
import pytest

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
    resolution: 0.1
"""

AMCL = """
amcl:
  ros__parameters:
    map_file: {map}
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
