"""The services' requests and responses, by the text of their .srv files: rosbags has none of them.

Source: the packages nav_msgs, std_srvs and rcl_interfaces of ROS 2, and slam_toolbox's folder srv.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from gridslam.io.bags.encoder import MessageEncoder

BODY: Final = "Body"
"""Suffix of the types without the header that rmw_cyclonedds puts before requests and responses."""

GRAPH: Final = "rmw_dds_common/ParticipantEntitiesInfo"
GRAPH_FROM_IRON: Final = f"{GRAPH}16"
"""The graph of nodes, whose GIDs have 24 bytes up to Humble, and 16 from Iron on."""

_GRAPH_TYPES: Final = {
    "rmw_dds_common/Gid16": "uint8[16] data",
    "rmw_dds_common/Node16": (
        "string node_namespace\nstring node_name\n"
        "rmw_dds_common/Gid16[] reader_gid_seq\nrmw_dds_common/Gid16[] writer_gid_seq"
    ),
    GRAPH_FROM_IRON: "rmw_dds_common/Gid16 gid\nrmw_dds_common/Node16[] node_entities_info_seq",
}
_REQUEST_HEADER: Final = "uint64 guid\nint64 sequence\n"
_EMPTY: Final = "uint8 structure_needs_at_least_one_member"
_NAMES: Final = "string[] names"
_PARAMETERS: Final = "rcl_interfaces/Parameter[] parameters"

_OF_BOTH: Final[Mapping[str, tuple[str, str]]] = {
    "nav_msgs/GetMap": ("", "nav_msgs/OccupancyGrid map"),
    "std_srvs/Empty": ("", ""),
    "std_srvs/SetBool": ("bool data", "bool success\nstring message"),
    "std_srvs/Trigger": ("", "bool success\nstring message"),
}
_OF_ROS2: Final[Mapping[str, tuple[str, str]]] = {
    "rcl_interfaces/ListParameters": (
        "string[] prefixes\nuint64 depth",
        "rcl_interfaces/ListParametersResult result",
    ),
    "rcl_interfaces/GetParameters": (_NAMES, "rcl_interfaces/ParameterValue[] values"),
    "rcl_interfaces/GetParameterTypes": (_NAMES, "uint8[] types"),
    "rcl_interfaces/DescribeParameters": (_NAMES, "rcl_interfaces/ParameterDescriptor[] descriptors"),
    "rcl_interfaces/SetParameters": (_PARAMETERS, "rcl_interfaces/SetParametersResult[] results"),
    "rcl_interfaces/SetParametersAtomically": (_PARAMETERS, "rcl_interfaces/SetParametersResult result"),
    "slam_toolbox/SerializePoseGraph": ("string filename", "uint8 result"),
    "slam_toolbox/DeserializePoseGraph": (
        "string filename\nint8 match_type\ngeometry_msgs/Pose2D initial_pose",
        "uint8 result",
    ),
    "slam_toolbox/SaveMap": ("std_msgs/String name", "uint8 result"),
    "slam_toolbox/Pause": ("", "bool status"),
    "slam_toolbox/Clear": ("", ""),
    "slam_toolbox/Reset": ("bool pause_new_measurements", "uint8 result"),
}


def service_encoder(*, is_ros1: bool = False) -> MessageEncoder:
    """Return an encoder that knows the requests and responses, `PACKAGE/NAME_Request` with rmw_cyclonedds's header."""
    encoder = MessageEncoder(is_ros1=is_ros1)
    for name, definition in _GRAPH_TYPES.items():
        encoder.define(name, definition)
    empty = "" if is_ros1 else _EMPTY
    for name, definitions in (_OF_BOTH if is_ros1 else {**_OF_BOTH, **_OF_ROS2}).items():
        for side, definition in zip(("Request", "Response"), definitions, strict=True):
            encoder.define(f"{name}_{side}", _REQUEST_HEADER + (definition or empty))
            encoder.define(f"{name}_{side}{BODY}", definition or empty)
    return encoder
