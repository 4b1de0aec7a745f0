"""The node on the wire of ROS 2, and a program on another vendor's DDS: scans in, the latched map out."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from support.dds_peer import Node, free_domain

STORE = get_typestore(Stores.ROS2_HUMBLE)
TYPES = {
    "SetBool_Request": "bool data",
    "SetBool_Response": "bool success\nstring message",
    "Names_Request": "string[] names",
    "ListParameters_Request": "string[] prefixes\nuint64 depth",
    "ListParameters_Response": "rcl_interfaces/ListParametersResult result",
    "GetParameters_Response": "rcl_interfaces/ParameterValue[] values",
    "GetParameterTypes_Response": "uint8[] types",
    "DescribeParameters_Response": "rcl_interfaces/ParameterDescriptor[] descriptors",
    "SetParameters_Request": "rcl_interfaces/Parameter[] parameters",
    "SetParameters_Response": "rcl_interfaces/SetParametersResult[] results",
    "GetMap_Request": "uint8 nothing",
    "GetMap_Response": "nav_msgs/OccupancyGrid map",
}
for name, definition in TYPES.items():
    STORE.register(get_types_from_msg(definition, f"test/msg/{name}"))

PEER = Path(__file__).resolve().parents[1] / "support" / "fastdds_peer.cpp"


@pytest.fixture(scope="module")
def peer(tmp_path_factory):
    """The program, compiled."""
    header = Path("/usr/include/fastdds/dds/domain/DomainParticipant.hpp")
    if not header.exists() or shutil.which("g++") is None:
        pytest.skip("Fast DDS is not installed (Debian: libfastrtps-dev, libfastcdr-dev and g++)")
    program = tmp_path_factory.mktemp("peer") / "peer"
    command = ["g++", "-std=c++17", "-O1", str(PEER), "-o", str(program), "-lfastrtps", "-lfastcdr"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr[-2000:]
    return program


def encoded(name, *values):
    made = STORE.types[f"test/msg/{name}"](*values)
    return bytes(STORE.serialize_cdr(made, f"test/msg/{name}")).hex()


def decoded(name, text):
    assert text, name
    return STORE.deserialize_cdr(bytes.fromhex(text), f"test/msg/{name}")


def parameter(name, value):
    types = STORE.types
    kind = types["rcl_interfaces/msg/ParameterValue"]
    none = np.zeros(0)
    given = kind(1, value, 0, 0.0, "", none.astype(np.uint8), none.astype(bool), none.astype(int), none, [])
    return types["rcl_interfaces/msg/Parameter"](name, given)


def calls():
    """Services as `ros2 service call` and `ros2 param` on rmw_fastrtps ask for them."""
    names = encoded("Names_Request", ["particles", "base_frame", "nonsense"])
    package = "rcl_interfaces"
    return [
        ("/gridslam/list_parameters", package, "ListParameters", encoded("ListParameters_Request", [], 0)),
        ("/gridslam/get_parameters", package, "GetParameters", names),
        ("/gridslam/get_parameter_types", package, "GetParameterTypes", names),
        ("/gridslam/describe_parameters", package, "DescribeParameters", names),
        (
            "/gridslam/set_parameters",
            package,
            "SetParameters",
            encoded(
                "SetParameters_Request", [parameter("paused_new_measurements", True), parameter("particles", True)]
            ),
        ),
        ("/gridslam/pause", "std_srvs", "SetBool", encoded("SetBool_Request", False)),
        ("/dynamic_map", "nav_msgs", "GetMap", encoded("GetMap_Request", 0)),
    ]


def test_another_vendor_s_program_is_understood_and_understands(peer, tmp_path):
    domain = free_domain()
    (tmp_path / "robot.yaml").write_text("/**:\n  ros__parameters:\n    particles: 4\n    map_update_interval: 0.3\n")
    parameters = "--ros-args", "--params-file", str(tmp_path / "robot.yaml")
    node = Node(domain, tmp_path / "node.log", *parameters, interface="")  # by ROS_LOCALHOST_ONLY
    try:
        command = [str(peer), str(domain), "80", *(part for call in calls() for part in call)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=400)
        assert done.returncode == 0, done.stderr + node.log.read_text()
        assert node.end() == 0, node.log.read_text()
    finally:
        node.kill()
    found = json.loads(done.stdout)
    grid = found["map"]
    assert found["links"] >= 30
    assert (grid["frame"], grid["resolution"], grid["origin"][2]) == ("map", 0.05, 1.0)
    assert grid["cells"] == grid["width"] * grid["height"]
    assert grid["unknown"] + grid["free"] + grid["occupied"] == grid["cells"]
    # The room has 24000 cells, of which a scan sees 270 degrees; each metre of its 32 m of wall has 20 cells.
    assert 4_000 < grid["free"] < 24_000
    assert 100 < grid["occupied"] < 1200
    check_graph(bytes.fromhex(found["graph"]))
    check_replies(found["replies"], grid)
    assert "request refused" not in node.log.read_text()


def check_graph(data):
    """By which `ros2 node list` knows the node, and `ros2 topic info --verbose` whose topics they are."""
    graph = STORE.deserialize_cdr(data, "rmw_dds_common/msg/ParticipantEntitiesInfo")
    (node,) = graph.node_entities_info_seq
    assert (node.node_namespace, node.node_name) == ("/", "gridslam")
    prefix = bytes(graph.gid.data.tolist())[:12]
    gids = [bytes(gid.data.tolist()) for gid in (*node.reader_gid_seq, *node.writer_gid_seq)]
    assert {gid[:12] for gid in gids} == {prefix}
    assert {gid[15] for gid in gids[: len(node.reader_gid_seq)]} == {4}  # readers without a key
    assert len(node.writer_gid_seq) >= 7 + 4 + 6  # topics, services, services of parameters
    assert len(set(gids)) == len(gids)


def check_replies(replies, grid):
    names = decoded("ListParameters_Response", replies["/gridslam/list_parameters"]).result.names
    assert {"particles", "base_frame", "scan_topic", "use_sim_time"} <= set(names)
    values = decoded("GetParameters_Response", replies["/gridslam/get_parameters"]).values
    assert [(value.type, value.integer_value, value.string_value) for value in values] == [
        (2, 4, ""),
        (4, 0, "base_link"),
        (0, 0, ""),
    ]
    assert decoded("GetParameterTypes_Response", replies["/gridslam/get_parameter_types"]).types.tolist() == [2, 4, 0]
    described = decoded("DescribeParameters_Response", replies["/gridslam/describe_parameters"]).descriptors
    assert [(one.name, one.type, one.read_only) for one in described[:2]] == [
        ("particles", 2, True),
        ("base_frame", 4, True),
    ]
    paused, particles = decoded("SetParameters_Response", replies["/gridslam/set_parameters"]).results
    assert paused.successful
    assert (particles.successful, "start it with -p particles:=" in particles.reason) == (False, True)
    assert decoded("SetBool_Response", replies["/gridslam/pause"]).message == "mapping"
    served = decoded("GetMap_Response", replies["/dynamic_map"]).map
    assert len(served.data) == served.info.width * served.info.height >= grid["cells"] // 2
