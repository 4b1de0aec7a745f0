"""Parameters, services and the log, as the verbs of `ros2` ask for them."""

import pytest
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters, ListParameters, SetParameters
from std_srvs.srv import Empty, SetBool, Trigger

from gridslam.io.maps import write_map
from support.localization_world import flat_map
from support.ros2_peer import Peer, Robot, last_map, nanoseconds
from support.ros_node import until


@pytest.fixture
def peer(domain):
    peer = Peer(domain)
    yield peer
    peer.close()


def parameter(name, value):
    kind = {bool: ("BOOL", "bool_value"), str: ("STRING", "string_value")}
    number, field = kind[type(value)]
    given = ParameterValue(type=getattr(ParameterType, f"PARAMETER_{number}"), **{field: value})
    return Parameter(name=name, value=given)


def set_one(peer, name, value):
    (result,) = peer.ask("/gridslam/set_parameters", SetParameters, parameters=[parameter(name, value)]).results
    return result.successful, result.reason


def test_parameters_that_were_given_are_listed_and_are_not_set(start, peer):
    node = start("-p", "delta:=0.1", "-p", "preset:=gmapping")
    names = peer.ask("/gridslam/list_parameters", ListParameters).result.names
    assert {"delta", "preset", "use_sim_time"} <= set(names)
    asked = ["delta", "preset", "use_sim_time"]
    got = peer.ask("/gridslam/get_parameters", GetParameters, names=asked).values
    assert (got[0].double_value, got[1].string_value, got[2].bool_value) == (0.1, "gmapping", False)
    successful, reason = set_one(peer, "preset", "default")
    assert (successful, reason) == (False, "preset: read when the node starts")
    assert set_one(peer, "use_sim_time", True) == (True, "")
    assert node.process.poll() is None


def test_services_answer_beside_the_scans(start, domain, drive, tmp_path):
    node = start(options=("-o", str(tmp_path / "out")))
    robot = Robot(domain)
    try:
        assert robot.meets()
        assert not robot.ask("/gridslam/save", Trigger).success
        robot.drive(drive[:60])
        assert until(lambda: len(robot.poses) >= 59)
        assert robot.ask("/gridslam/save", Trigger).success
        assert (tmp_path / "out" / "map.pgm").is_file()
        assert until((tmp_path / "out" / "autosave.gridslam").is_file)
        answer = robot.ask("/gridslam/pause", SetBool, data=True)
        assert (answer.success, answer.message) == (True, "paused")
        assert robot.ask("/gridslam/pause", SetBool, data=False).message == "mapping"
        robot.ask("/gridslam/reset", Empty)
        assert node.says("starting a new map: reset")
    finally:
        robot.close()


def test_a_known_map_is_given(start, peer, tmp_path):
    """As nav2's map_server gives it: latched, and stamped by the clock once that is there."""
    write_map(tmp_path / "flat.yaml", flat_map())
    start(options=("--map", str(tmp_path / "flat.yaml")))
    grid = last_map(peer)
    assert nanoseconds(grid.header.stamp) > 0
