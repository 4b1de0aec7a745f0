"""The node in a known map: where the robot is, told as AMCL tells it, and placed by people."""

import struct

import numpy as np
import pytest

from gridslam.errors import ArgumentError, GridslamError, InputError
from gridslam.geometry.se2 import between
from gridslam.io.bags.encoder import MessageEncoder, MessageError
from gridslam.io.maps import write_map
from gridslam.ros import NodeCore
from gridslam.ros.node.messages import Level
from gridslam.ros.node.parameters import node_parameters
from gridslam.ros.node.ros_node import set_pose_from_message
from support.localization_world import drive, flat_map
from support.ros_bytes import encode_message
from support.ros_node import RecordedOutputs, mounting, play, until

SHIFT_NS = 1_700_000_000 * 10**9
HERE = np.array([2.6, 1.6, 0.0])
COVARIANCE = np.diag([0.04, 0.04, 0.03])


@pytest.fixture(scope="module")
def map_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("map") / "flat.yaml"
    write_map(path, flat_map())
    return path


@pytest.fixture(scope="module")
def log():
    return drive(3)


def node(outputs, map_file, record=None, **given):
    parameters = node_parameters({"map_file": str(map_file), **given})
    core = NodeCore(parameters.settings, parameters.configuration, outputs, record=record)
    core.on_transforms([mounting(0.0, 0.0)._replace(pose=(0.0,) * 6 + (1.0,))], static=True)
    core.start()
    return core


def driven(core, outputs, log, scans):
    done = len(outputs.poses)
    sent = play(core, outputs, log.measurements[:scans], shift_ns=SHIFT_NS, ahead=5)  # the clock is the last scan's
    assert until(lambda: len(outputs.poses) == done + sent), outputs.warnings()
    return between(log.truth.poses[scans - 1], outputs.poses[-1].pose)


def placed(log):
    x, y, theta = log.truth.poses[0].tolist()
    return {"initial_pose_x": x, "initial_pose_y": y, "initial_pose_a": theta}


def test_a_robot_that_is_placed_is_followed_and_told(map_file, log):
    outputs = RecordedOutputs()
    core = node(outputs, map_file, initial_cov_xx=0.04, initial_cov_yy=0.04, initial_cov_aa=0.03, **placed(log))
    assert outputs.maps[0] is core.dynamic_map()
    apart = driven(core, outputs, log, 60)
    assert np.hypot(*apart[:2]) < 0.3
    assert abs(apart[2]) < 0.15
    last = outputs.transforms[-1]
    assert (last.parent, last.child) == ("map", "odom")
    told = core.diagnostics()
    assert (told.level, told.summary) == (Level.OK, "localizing")
    assert len(outputs.clouds[-1].poses) >= 100
    assert len(outputs.clouds[-1].data()) == 56 * len(outputs.clouds[-1].poses)
    assert until(lambda: len(outputs.maps) == 2), "once more when the clock has begun"
    assert [known.stamp_ns > 0 for known in outputs.maps] == [False, True]
    assert core.close() is None


def test_people_say_where_the_robot_is(map_file, log):
    outputs = RecordedOutputs()
    core = node(outputs, map_file)
    core.set_pose((np.array(log.truth.poses[0]), COVARIANCE))
    apart = driven(core, outputs, log, 30)
    assert np.hypot(*apart[:2]) < 0.3
    core.reset()
    play(core, outputs, log.measurements[30:31], shift_ns=SHIFT_NS)
    assert until(lambda: len(outputs.poses) == 31)
    assert core.diagnostics()[:2] == (Level.OK, "looking for the robot in the whole map")
    assert "restarts" not in outputs.warnings()
    core.close()


def message(frame="map", pose=(1.0, 2.0, 0.0, 0.0, 0.0, 1.0, 0.0), yaw_variance=0.03):
    covariance = [0.0] * 36
    covariance[0], covariance[7], covariance[35] = 0.04, 0.05, yaw_variance
    ros1 = struct.pack("<III", 1, 5, 6) + struct.pack("<I", len(frame)) + frame.encode()
    ros1 += struct.pack("<43d", *pose, *covariance)
    values = ((5, 6), frame), ((pose[:3], pose[3:]), covariance)
    return ros1, encode_message("geometry_msgs/PoseWithCovarianceStamped", values)


@pytest.mark.parametrize("which", [0, 1])
def test_where_people_say_it_is_comes_as_a_message(map_file, which, monkeypatch):
    core, found = node(RecordedOutputs(), map_file), []
    encoder = MessageEncoder(is_ros1=which == 0)

    def told(data):
        set_pose_from_message(core, encoder.decode("geometry_msgs/PoseWithCovarianceStamped", data))

    monkeypatch.setattr(core, "set_pose", found.append)
    told(message()[which])
    ((pose, covariance),) = found
    np.testing.assert_allclose(pose, [1.0, 2.0, np.pi])
    np.testing.assert_array_equal(covariance, np.diag([0.04, 0.05, 0.03]))
    monkeypatch.undo()
    for wrong, says in (
        (message(frame="odom"), "expected a pose in the frame map, got 'odom'"),
        (message(pose=(np.nan, 0, 0, 0, 0, 0, 1)), "pose: expected finite"),
        (message(yaw_variance=-1.0), "covariance: expected a symmetric"),
        ((b"", b"\0\1\0\0"), "unpack|buffer"),
    ):
        with pytest.raises(MessageError, match=says):
            told(wrong[which])
    core.close()


def test_amcl_s_parameters_by_their_names(map_file):
    given = {
        "map_file": str(map_file),
        "min_particles": 50,
        "max_particles": 200,
        "odom_frame_id": "wheels",
        "transform_tolerance": 0.2,
        "do_beamskip": True,
        "preset": "gmapping",
        "particels": 3,
        "set": "max_beams=33",
    }
    found = node_parameters(given)
    assert (found.settings.odom_frame, found.settings.tf_delay_s) == ("wheels", 0.2)
    parts = found.configuration.configuration
    assert (parts.kld.particles_min, parts.kld.particles_max, parts.max_beams) == (50, 200, 33)
    assert "do_beamskip (it has no equivalent)" in found.warning
    assert "preset (the node localizes and builds no map)" in found.warning
    assert "particels (there is no such parameter" in found.warning
    assert found.configuration.initial_pose is None


def test_a_map_that_is_none_is_refused():
    with pytest.raises(InputError, match=r"none\.yaml"):
        node_parameters({"map_file": "none.yaml"})


def test_a_node_that_maps_cannot_be_placed_and_one_that_localizes_saves_no_map(map_file, tmp_path):
    parameters = node_parameters({"particles": 3})
    core = NodeCore(parameters.settings, parameters.configuration, RecordedOutputs())
    with pytest.raises(ArgumentError, match="pose: expected a node that localizes"):
        core.set_pose((HERE, COVARIANCE))
    core.close()
    core = node(RecordedOutputs(), map_file)
    with pytest.raises(ArgumentError, match=r"pose: expected a place in the map, x from .*, got 1e\+09, 0"):
        core.set_pose((np.array([1e9, 0.0, 0.0]), COVARIANCE))
    with pytest.raises(GridslamError, match="gridslam localize"):
        core.save(tmp_path / "out")
    core.close()


def test_a_bag_that_is_played_again_is_a_warning_as_no_map_ends(map_file, log):
    outputs = RecordedOutputs()
    core = node(outputs, map_file, **placed(log))
    driven(core, outputs, log, 20)
    play(core, outputs, log.measurements[:20], shift_ns=SHIFT_NS, ahead=5)
    try:
        assert until(lambda: "localization restarts: time jumped back" in outputs.warnings())
        said = [message for message in core.messages.to_list() if message["text"].startswith("localization restarts")]
        assert [message["level"] for message in said] == ["warning"]
    finally:
        core.close()
