"""Where AMCL was before: its topics and its services."""

import numpy as np
import pytest

from gridslam.errors import ConfigurationError
from gridslam.io.bags.encoder import MessageEncoder
from gridslam.io.maps import write_map
from gridslam.ros.node.messages import CloudMessage
from gridslam.ros.node.outputs import EncodedOutputs
from gridslam.ros.node.parameters import node_parameters
from gridslam.ros.node.ros_node import RosNode
from gridslam.ros.node.transport import ALL_TOPICS
from support.localization_world import drive as flat_drive
from support.localization_world import flat_map
from support.ros_node import LocalTransport, mounting, play, until

SHIFT_NS = 1_700_000_000_000_000_000
ENCODERS = {"ROS 1": MessageEncoder(is_ros1=True), "ROS 2": MessageEncoder(is_ros1=False)}


@pytest.fixture(scope="module")
def log():
    return flat_drive(3)


@pytest.fixture(scope="module")
def map_file(tmp_path_factory):
    folder = tmp_path_factory.mktemp("map")
    write_map(folder / "flat.yaml", flat_map())
    return folder / "flat.yaml"


def started(given, transport=None):
    node = RosNode(transport or LocalTransport(), node_parameters(given, "default"))
    node.start()
    node.core.on_transforms([mounting()], static=True)
    return node


def placed(log):
    x, y, theta = log.truth.poses[0].tolist()
    return {"initial_pose_x": x, "initial_pose_y": y, "initial_pose_a": theta, "initial_cov_xx": 0.04}


def test_amcl_s_topics_have_nav2_s_names_and_types(map_file, log):
    transport = LocalTransport()
    node = started({"map_file": str(map_file), **placed(log)}, transport)
    outputs = transport.outputs
    assert transport.published["amcl_pose"] == "geometry_msgs/PoseWithCovarianceStamped"
    assert transport.published["particle_cloud"] == "nav2_msgs/ParticleCloud"
    play(node.core, outputs, log.measurements[:30], shift_ns=SHIFT_NS)
    assert until(lambda: len(outputs.poses) == 30 and len(outputs.updated_poses) == len(outputs.clouds))
    assert 3 <= len(outputs.clouds) < 30
    np.testing.assert_allclose([cloud.weights.sum() for cloud in outputs.clouds], 1.0)
    node.close()
    assert "particle_cloud" not in RosNode(LocalTransport(), node_parameters({}, "default"))._transport.published


@pytest.mark.parametrize("ros", ENCODERS)
def test_a_cloud_with_weights_is_what_nav2_reads(ros):
    sent = {}
    encoder = ENCODERS[ros]
    outputs = EncodedOutputs(encoder, sent.__setitem__, lambda: 0, lambda level, text: None, "node")
    outputs.topics = ALL_TOPICS
    outputs.particles(CloudMessage(5, "map", np.array([[1.0, 2.0, np.pi], [3.0, 4.0, 0.0]]), np.array([0.25, 0.75])))
    cloud = encoder.decode(ALL_TOPICS["particle_cloud"], sent["particle_cloud"])
    assert [(one.pose.position.x, one.pose.position.y, one.weight) for one in cloud.particles] == [
        (1.0, 2.0, 0.25),
        (3.0, 4.0, 0.75),
    ]
    assert cloud.particles[0].pose.orientation.z == pytest.approx(1.0)


def test_without_tf_broadcast_no_transform_is_published():
    assert node_parameters({"tf_broadcast": False}, "default").settings.transform_publish_period_s == 0.0
    with pytest.raises(ConfigurationError, match="tf_broadcast: expected true or false, got 0"):
        node_parameters({"tf_broadcast": 0}, "default")
