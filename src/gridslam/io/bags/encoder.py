"""Messages of ROS 1 and ROS 2, made and encoded by rosbags."""

from __future__ import annotations

import struct
from collections import Counter
from typing import Any, Final, NamedTuple, TypeAlias, final

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from gridslam.errors import ArgumentError

Values: TypeAlias = tuple[Any, ...]
"""Values of a message's fields in their order; those of a nested message are such a tuple, too."""


_DEFINITIONS: Final = {
    "nav2_msgs/msg/Particle": "geometry_msgs/Pose pose\nfloat64 weight",
    "nav2_msgs/msg/ParticleCloud": "std_msgs/Header header\nnav2_msgs/Particle[] particles",
}
"""Types that rosbags does not have, in ROS 1 and 2."""


class Field(NamedTuple):
    """A field of a message: name, type of its elements, and how many: None for one, 0 for a sequence of any length."""

    name: str
    type: str
    length: int | None


class MessageError(ValueError):
    """The bytes are no such message."""


@final
class MessageEncoder:
    """Encodes messages as ROS 1 or ROS 2 does; types are "sensor_msgs/LaserScan" or "sensor_msgs/msg/LaserScan".

    Parameters
    ----------
    is_ros1 : bool
        Whether messages are those of ROS 1, whose headers are numbered; else of ROS 2, as plain CDR.

    Attributes
    ----------
    store : rosbags.typesys.store.Typestore
        The types.
    """

    def __init__(self, *, is_ros1: bool) -> None:
        self.is_ros1 = is_ros1
        self.store = get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_HUMBLE)
        self._fields: dict[str, list[Field]] = {}
        self._numbers: Counter[str] = Counter()
        for name, definition in _DEFINITIONS.items():
            self.define(name, definition)
        if is_ros1:
            self.define("tf2_msgs/msg/TFMessage", "geometry_msgs/TransformStamped[] transforms")

    def define(self, message_type: str, definition: str) -> None:
        """Add a type that rosbags does not have, by the text of its .msg file."""
        self.store.register(get_types_from_msg(definition, _full_name(message_type)))

    def header(self, topic: str, stamp_ns: int, frame: str) -> Values:
        """Return the values of the next header on a topic; raises ArgumentError for a stamp that has no place in it."""
        stamp = divmod(stamp_ns, 1_000_000_000)
        if not 0 <= stamp[0] < 2**31:
            raise ArgumentError("stamp_ns", "a stamp that ROS can represent, from 0 on and below 2^31 s", stamp_ns)
        if not self.is_ros1:
            return stamp, frame
        self._numbers[topic] += 1
        return self._numbers[topic] - 1, stamp, frame

    def encode(self, message_type: str, *values: Any) -> bytes:  # noqa: ANN401
        """Return the bytes of a message with a value for each field; arrays of numbers may be NumPy's."""
        serialize = self.store.serialize_ros1 if self.is_ros1 else self.store.serialize_cdr
        return bytes(serialize(self._make(message_type, values), _full_name(message_type)))

    def decode(self, message_type: str, data: bytes) -> Any:  # noqa: ANN401
        """Return the message with these bytes; raises MessageError where they are none of this type."""
        deserialize = self.store.deserialize_ros1 if self.is_ros1 else self.store.deserialize_cdr
        try:
            return deserialize(data, _full_name(message_type))
        except (SerdeError, struct.error, ValueError, IndexError) as error:
            raise MessageError(str(error)) from None

    def fields(self, message_type: str) -> list[Field]:
        """Return the fields of a type in their order."""
        if message_type not in self._fields:
            described: Any = self.store.fielddefs[_full_name(message_type)][1]
            self._fields[message_type] = [_field(name, *description) for name, description in described]
        return self._fields[message_type]

    def _make(self, message_type: str, values: Values) -> Any:  # noqa: ANN401
        made = []
        for (_, kind, length), value in zip(self.fields(message_type), values, strict=True):
            if "/" not in kind:
                is_plain = length is None or kind == "string"
                made.append(value if is_plain else np.asarray(value, "uint8" if kind in ("byte", "char") else kind))
            elif length is None:
                made.append(self._make(kind, value))
            else:
                made.append([self._make(kind, one) for one in value])
        return self.store.types[_full_name(message_type)](*made)


def _field(name: str, kind: Nodetype, content: Any) -> Field:  # noqa: ANN401
    length = None
    if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        (_, content), length = content
    return Field(name, content if isinstance(content, str) else content[0], length)


def _full_name(message_type: str) -> str:
    """Return the name that rosbags gives to a type."""
    parts = message_type.split("/")
    return f"{parts[0]}/msg/{parts[-1]}"
