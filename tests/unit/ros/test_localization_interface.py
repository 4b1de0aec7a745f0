"""Where AMCL was before: its topics, its services, maps that come as messages, and a managed node."""

from types import SimpleNamespace

import numpy as np
import pytest

from gridslam.errors import ArgumentError, ConfigurationError
from gridslam.io.bags.encoder import MessageEncoder
from gridslam.io.bags.ros_messages import MessageError
from gridslam.io.maps import grid_of_percent, read_map, write_map
from gridslam.ros.node.grid_input import grid_of
from gridslam.ros.node.messages import CloudMessage
from gridslam.ros.node.outputs import EncodedOutputs, grid_values
from gridslam.ros.node.parameters import NodeSettings, node_parameters
from gridslam.ros.node.rendering import make_grid_message
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


def grid_message(frame="map"):
    message = make_grid_message(flat_map(), NodeSettings(), 7)
    return message._replace(frame=frame)


def started(given, transport=None):
    node = RosNode(transport or LocalTransport(), node_parameters({"mode": "localization", **given}, "default"))
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
    assert until(lambda: len(outputs.poses) == 30)
    assert 3 <= len(outputs.updated_poses) == len(outputs.clouds) < 30
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


def test_a_robot_at_rest_is_updated_when_that_is_requested(map_file, log):
    transport = LocalTransport()
    node = started({"map_file": str(map_file), **placed(log)}, transport)
    outputs = transport.outputs
    standing = log.measurements[0]

    def repeat(number):
        scan = standing._replace(odometry=type(standing.odometry)(standing.odometry.stamp_ns, standing.odometry.pose))
        before = len(outputs.poses)
        play(node.core, outputs, [scan], shift_ns=SHIFT_NS + number * 100_000_000)
        assert until(lambda: len(outputs.poses) > before)

    for number in range(4):
        repeat(number)
    assert len(outputs.clouds) == 1
    transport.services["request_nomotion_update"](None)
    repeat(5)
    repeat(6)
    assert len(outputs.clouds) == 2
    node.close()


def test_a_map_may_come_by_a_topic(log):
    transport = LocalTransport()
    node = started({"use_map_topic": True, **placed(log)}, transport)
    core, outputs = node.core, transport.outputs
    assert "map" not in transport.published
    assert "waiting for a map on /map" in outputs.warnings()
    assert core.diagnostics().summary == "waiting for a map"
    play(core, outputs, log.measurements[:2], shift_ns=SHIFT_NS)
    with pytest.raises(ArgumentError, match="the frame map"):
        core.set_map(grid_message("world"))
    core.set_map(grid_message())
    assert until(lambda: "localizing in a map of" in outputs.warnings())
    assert until(lambda: not core._queue.waits_for_map)
    play(core, outputs, log.measurements[2:40], shift_ns=SHIFT_NS)
    assert until(lambda: len(outputs.poses) == 38)
    assert np.hypot(*(outputs.poses[-1].pose - log.truth.poses[39])[:2]) < 0.5
    core.set_map(grid_message())  # the same once more, as a map_server may send it
    other = grid_message()
    core.set_map(other._replace(cells=other.cells[:-1]), only_first=True)
    play(core, outputs, log.measurements[40:42], shift_ns=SHIFT_NS)
    assert until(lambda: len(outputs.poses) == 40)
    assert outputs.warnings().count("localizing in a map of") == 1
    assert outputs.maps == []
    node.close()


def test_a_map_may_be_set_by_a_service_with_a_pose(map_file, log):
    transport = LocalTransport()
    node = started({"map_file": str(map_file)}, transport)
    encoder = ENCODERS["ROS 2"]
    values = grid_values(encoder, "map", grid_message())
    grid = encoder.decode("nav_msgs/OccupancyGrid", encoder.encode("nav_msgs/OccupancyGrid", *values))
    x, y, theta = log.truth.poses[0].tolist()
    turn = (0.0, 0.0, np.sin(theta / 2), np.cos(theta / 2))
    covariance = np.diag([0.04, 0.04, 0, 0, 0, 0.03]).ravel()
    pose = encoder.decode(
        "geometry_msgs/PoseWithCovarianceStamped",
        encoder.encode("geometry_msgs/PoseWithCovarianceStamped", ((0, 0), "map"), (((x, y, 0.0), turn), covariance)),
    )
    grid.data = np.where(grid.data == 0, 1, grid.data)  # another map
    assert transport.services["set_map"](SimpleNamespace(map=grid, initial_pose=pose)) == (True,)
    assert until(lambda: "localizing in a map of" in transport.outputs.warnings())
    play(node.core, transport.outputs, log.measurements[:20], shift_ns=SHIFT_NS)
    assert until(lambda: len(transport.outputs.poses) == 20)
    assert np.hypot(*(transport.outputs.poses[-1].pose - log.truth.poses[19])[:2]) < 0.3
    again = SimpleNamespace(map=grid, initial_pose=pose)  # the same map: only the pose is set
    assert transport.services["set_map"](again) == (True,)
    assert until(lambda: node.core._session._next_state is not None)
    assert np.hypot(*(node.core._session._next_state.poses.mean(axis=0) - log.truth.poses[0])[:2]) < 0.1
    assert transport.outputs.warnings().count("localizing in a map of") == 1
    grid.header.frame_id = "elsewhere"
    assert transport.services["set_map"](SimpleNamespace(map=grid, initial_pose=pose)) == (False,)
    node.close()


def test_without_tf_broadcast_no_transform_is_published():
    assert node_parameters({"tf_broadcast": False}, "default").settings.transform_publish_period_s == 0.0
    with pytest.raises(ConfigurationError, match="tf_broadcast: expected true or false, got 0"):
        node_parameters({"tf_broadcast": 0}, "default")


@pytest.mark.parametrize("ros", ENCODERS)
def test_maps_are_decoded_from_their_bytes(ros, map_file):
    encoder = ENCODERS[ros]
    sent = grid_message("/map")
    data = encoder.encode("nav_msgs/OccupancyGrid", *grid_values(encoder, "map", sent))
    found = grid_of(encoder.decode("nav_msgs/OccupancyGrid", data))
    assert (found.frame, found.origin) == ("map", sent.origin)
    np.testing.assert_array_equal(found.cells, sent.cells)
    grid, of_file = grid_of_percent(found.cells, found.resolution_m, found.origin), read_map(map_file)
    np.testing.assert_array_equal(grid.known, of_file.known)
    np.testing.assert_allclose(grid.log_odds[grid.known], of_file.log_odds[of_file.known], atol=1e-5)
    for wrong in (data[:60], data[:-5]):
        with pytest.raises(MessageError, match=r"unpack_from|buffer|Invalid sequence length"):
            encoder.decode("nav_msgs/OccupancyGrid", wrong)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"cells": np.full((2, 2), 101, np.int8)}, "not between -1 and 100"),
        ({"resolution_m": 0.0}, "of 0 m"),
        ({"cells": np.zeros((0, 0), np.int8)}, "0 x 0"),
        ({"origin": (np.nan, 0.0)}, "origin"),
    ],
)
def test_what_is_no_map_is_named(change, says):
    encoder = ENCODERS["ROS 2"]
    message = grid_message()._replace(**change)
    data = encoder.encode("nav_msgs/OccupancyGrid", *grid_values(encoder, "map", message))
    with pytest.raises(MessageError, match=says):
        grid_of(encoder.decode("nav_msgs/OccupancyGrid", data))
