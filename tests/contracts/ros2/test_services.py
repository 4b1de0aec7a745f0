"""Parameters, services and the log, as the verbs of `ros2` ask for them."""

import pytest
from rcl_interfaces.msg import Parameter, ParameterEvent, ParameterType, ParameterValue
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    GetParameterTypes,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)
from slam_toolbox.srv import Pause, SerializePoseGraph
from std_srvs.srv import Empty, SetBool, Trigger

from gridslam.io.maps import read_map, write_map
from gridslam.io.sessions.session_file import read_session
from support.localization_world import flat_map
from support.ros2_peer import Peer, Robot, last_map, nanoseconds
from support.ros_node import until


@pytest.fixture
def peer(domain):
    peer = Peer(domain)
    yield peer
    peer.close()


def parameter(name, value):
    kind = {bool: ("BOOL", "bool_value"), int: ("INTEGER", "integer_value"), str: ("STRING", "string_value")}
    number, field = kind[type(value)]
    given = ParameterValue(type=getattr(ParameterType, f"PARAMETER_{number}"), **{field: value})
    return Parameter(name=name, value=given)


def set_one(peer, name, value):
    (result,) = peer.ask("/gridslam/set_parameters", SetParameters, parameters=[parameter(name, value)]).results
    return result.successful, result.reason


def test_parameters_are_listed_read_described_and_set(start, peer):
    node = start("-p", "resolution:=0.1", "-p", "preset:=gmapping")
    names = peer.ask("/gridslam/list_parameters", ListParameters).result.names
    assert {"particles", "resolution", "preset", "use_sim_time", "save_as"} <= set(names)
    asked = ["particles", "delta", "resolution", "preset", "use_sim_time"]
    got = peer.ask("/gridslam/get_parameters", GetParameters, names=asked).values
    assert [one.type for one in got] == [2, 3, 3, 4, 1]
    assert [one.type for one in got] == list(
        peer.ask("/gridslam/get_parameter_types", GetParameterTypes, names=asked).types
    )
    assert (got[0].integer_value, got[1].double_value, got[2].double_value) == (4, 0.1, 0.1)
    assert (got[3].string_value, got[4].bool_value) == ("gmapping", False)
    described = peer.ask(
        "/gridslam/describe_parameters", DescribeParameters, names=["particles", "save_as"]
    ).descriptors
    assert [(one.name, one.type, one.read_only) for one in described] == [("particles", 2, True), ("save_as", 4, False)]
    events = peer.hear("/parameter_events", ParameterEvent)
    assert until(lambda: peer.node.count_publishers("/parameter_events") >= 2)
    for name, why in (("anything", "undeclared parameter"), ("particles", "read-only parameter")):
        successful, reason = set_one(peer, name, 3)
        assert (successful, why in reason) == (False, True), reason
    assert set_one(peer, "save_as", 3)[0] is False
    assert set_one(peer, "save_as", "floors/first") == (True, "")
    both = [parameter("paused_new_measurements", True), parameter("nothing", 1)]
    assert not peer.ask(
        "/gridslam/set_parameters_atomically", SetParametersAtomically, parameters=both
    ).result.successful
    assert set_one(peer, "use_sim_time", True) == (True, "")
    changed = [one.name for event in list(events) if event.node == "/gridslam" for one in event.changed_parameters]
    assert until(lambda: len(events) >= 2)
    assert set(changed) <= {"save_as", "use_sim_time"}
    assert "save_as" in [one.name for event in events for one in event.changed_parameters]
    assert node.process.poll() is None


def test_services_answer_beside_the_scans(start, domain, drive, tmp_path):
    node = start(options=("-o", str(tmp_path / "out")))
    robot = Robot(domain)
    try:
        assert robot.meets()
        assert not robot.ask("/gridslam/serialize_map", Trigger).success
        robot.drive(drive[:60])
        assert until(lambda: len(robot.poses) >= 59)
        assert robot.ask("/gridslam/save", Trigger).success
        assert (tmp_path / "out" / "map.pgm").is_file()
        assert set_one(robot, "save_as", str(tmp_path / "floors" / "first")) == (True, "")
        assert robot.ask("/gridslam/serialize_map", Trigger).success, node.log.read_text()
        assert len(read_session(tmp_path / "floors" / "first.gridslam").run.trajectory.keys) >= 59
        assert robot.ask("/gridslam/save_map", Trigger).success
        assert read_map(tmp_path / "floors" / "first.yaml").known.any()
        answer = robot.ask("/gridslam/pause", SetBool, data=True)
        assert (answer.success, answer.message) == (True, "paused")
        assert robot.ask("/gridslam/pause", SetBool, data=False).message == "mapping"
        robot.ask("/gridslam/reset", Empty)
        assert node.says("starting a new map: reset")
    finally:
        robot.close()


def test_slam_toolbox_s_services_are_there_by_their_names_and_types(start, peer, tmp_path):
    start()
    assert peer.ask("/slam_toolbox/pause_new_measurements", Pause).status
    assert peer.ask("/slam_toolbox/serialize_map", SerializePoseGraph, filename=str(tmp_path / "none")).result == 255


def test_a_known_map_is_given(start, peer, tmp_path):
    """As nav2's map_server gives it: latched, and stamped by the clock once that is there."""
    write_map(tmp_path / "flat.yaml", flat_map())
    start(options=("--map", str(tmp_path / "flat.yaml")))
    grid = last_map(peer)
    assert nanoseconds(grid.header.stamp) > 0
