"""Fields and encoding of the node's ROS 2 messages.

Source: the public definitions of common_interfaces (sensor_msgs, nav_msgs, ...); OMG, DDS-XTypes 1.3, section 7.4.3
(plain CDR, little-endian).
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple, final

__all__ = ["FIELDS", "PRIMITIVES", "Field", "decode_message", "encode_message", "parse_fields"]

PRIMITIVES: Final[Mapping[str, str]] = {
    "bool": "?", "uint8": "B", "int8": "b", "int32": "i", "uint32": "I", "int64": "q", "uint64": "Q", "float32": "f",
    "float64": "d",
}  # fmt: skip
"""Numeric types and their `struct` formats; each value is aligned to its size."""

_HEADER = "std_msgs/Header header"
_REQUEST_HEADER = "uint64 guid, int64 sequence"  # that rmw_cyclonedds prepends to requests and replies
_EMPTY = "uint8 structure_needs_at_least_one_member"

FIELDS: Final[Mapping[str, str]] = {
    "builtin_interfaces/Time": "int32 sec, uint32 nanosec",
    "std_msgs/Header": "builtin_interfaces/Time stamp, string frame_id",
    "std_msgs/Float64": "float64 data",
    "rosgraph_msgs/Clock": "builtin_interfaces/Time clock",
    "geometry_msgs/Point": "float64 x, float64 y, float64 z",
    "geometry_msgs/Vector3": "float64 x, float64 y, float64 z",
    "geometry_msgs/Quaternion": "float64 x, float64 y, float64 z, float64 w",
    "geometry_msgs/Pose": "geometry_msgs/Point position, geometry_msgs/Quaternion orientation",
    "geometry_msgs/PoseWithCovariance": "geometry_msgs/Pose pose, float64[36] covariance",
    "geometry_msgs/PoseWithCovarianceStamped": f"{_HEADER}, geometry_msgs/PoseWithCovariance pose",
    "geometry_msgs/PoseArray": f"{_HEADER}, geometry_msgs/Pose[] poses",
    "geometry_msgs/Transform": "geometry_msgs/Vector3 translation, geometry_msgs/Quaternion rotation",
    "geometry_msgs/TransformStamped": f"{_HEADER}, string child_frame_id, geometry_msgs/Transform transform",
    "tf2_msgs/TFMessage": "geometry_msgs/TransformStamped[] transforms",
    "sensor_msgs/LaserScan": (
        f"{_HEADER}, float32 angle_min, float32 angle_max, float32 angle_increment, float32 time_increment, "
        "float32 scan_time, float32 range_min, float32 range_max, float32[] ranges, float32[] intensities"
    ),
    "nav_msgs/MapMetaData": (
        "builtin_interfaces/Time map_load_time, float32 resolution, uint32 width, uint32 height, "
        "geometry_msgs/Pose origin"
    ),
    "nav_msgs/OccupancyGrid": f"{_HEADER}, nav_msgs/MapMetaData info, int8[] data",
    "diagnostic_msgs/KeyValue": "string key, string value",
    "diagnostic_msgs/DiagnosticStatus": (
        "uint8 level, string name, string message, string hardware_id, diagnostic_msgs/KeyValue[] values"
    ),
    "diagnostic_msgs/DiagnosticArray": f"{_HEADER}, diagnostic_msgs/DiagnosticStatus[] status",
    "nav_msgs/GetMap_Request": f"{_REQUEST_HEADER}, {_EMPTY}",
    "nav_msgs/GetMap_Response": f"{_REQUEST_HEADER}, nav_msgs/OccupancyGrid map",
    "std_srvs/Empty_Request": f"{_REQUEST_HEADER}, {_EMPTY}",
    "std_srvs/Empty_Response": f"{_REQUEST_HEADER}, {_EMPTY}",
    "std_srvs/SetBool_Request": f"{_REQUEST_HEADER}, bool data",
    "std_srvs/SetBool_Response": f"{_REQUEST_HEADER}, bool success, string message",
    "std_srvs/Trigger_Request": f"{_REQUEST_HEADER}, {_EMPTY}",
    "std_srvs/Trigger_Response": f"{_REQUEST_HEADER}, bool success, string message",
}
"""Fields of each type, in order."""


class Field(NamedTuple):
    """A field of a message: element type, length and name.

    `length` is None for a single value, 0 for a sequence of any length.
    """

    type: str
    length: int | None
    name: str


def parse_fields(message_type: str) -> list[Field]:
    """Return the fields of a type in `FIELDS`."""
    found = []
    for text in FIELDS[message_type].split(", "):
        kind, name = text.split(" ")
        element, bracket, count = kind.rstrip("]").partition("[")
        found.append(Field(element, int(count or 0) if bracket else None, name))
    return found


_FIELD_LISTS: Final = {name: parse_fields(name) for name in FIELDS}


def encode_message(message_type: str, values: Sequence[Any]) -> bytes:
    """Bytes of a message, starting with the four bytes that declare plain CDR.

    Parameters
    ----------
    message_type : str
        One of `FIELDS`.
    values : sequence
        A value for each field, in order: numbers, str, nested sequences for nested types; an array of int8 may be
        bytes.
    """
    writer = _Writer()
    writer.message(message_type, values)
    return b"\0\1\0\0" + bytes(writer.data)


@final
class _Writer:
    """Appends fields, each aligned to its size."""

    def __init__(self) -> None:
        self.data = bytearray()

    def message(self, message_type: str, values: Sequence[Any]) -> None:
        for field, value in zip(_FIELD_LISTS[message_type], values, strict=True):
            self._field(field, value)

    def _field(self, field: Field, value: Any) -> None:  # noqa: ANN401
        if field.length is None:
            self._element(field.type, value)
            return
        if field.length == 0:
            self._numbers("I", [len(value)])
        if isinstance(value, bytes):
            self.data += value
        elif field.type in PRIMITIVES:
            if len(value):
                self._numbers(PRIMITIVES[field.type], value)
        else:
            for one in value:
                self._element(field.type, one)

    def _element(self, kind: str, value: Any) -> None:  # noqa: ANN401
        if kind == "string":
            text = value.encode() + b"\0"
            self._numbers("I", [len(text)])
            self.data += text
        elif kind in PRIMITIVES:
            self._numbers(PRIMITIVES[kind], [value])
        else:
            self.message(kind, value)

    def _numbers(self, form: str, values: Sequence[Any]) -> None:
        self.data += bytes(-len(self.data) % struct.calcsize(form))
        self.data += struct.pack(f"<{len(values)}{form}", *values)


def decode_message(message_type: str, data: bytes) -> list[Any]:
    """Decode a message without arrays and strings (a clock, a request); raises ValueError if the bytes are invalid."""
    if data[:2] not in (b"\0\0", b"\0\1"):
        raise ValueError(f"expected plain CDR (00 00 or 00 01), got {data[:2].hex(' ') or 'nothing'}")
    order, offset = "<" if data[1] else ">", 4
    values: list[Any] = []
    for field in _flatten(message_type):
        form = struct.Struct(order + PRIMITIVES[field.type])
        offset += -(offset - 4) % form.size
        if offset + form.size > len(data):
            raise ValueError(f"a {message_type} of {len(data)} bytes is too short")
        values += form.unpack_from(data, offset)
        offset += form.size
    return values


def _flatten(message_type: str) -> list[Field]:
    found: list[Field] = []
    for field in _FIELD_LISTS[message_type]:
        found += [field] if field.type in PRIMITIVES else _flatten(field.type)
    return found
