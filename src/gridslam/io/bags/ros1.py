"""The records of ROS 1 bags (format 2.0).

Source: wiki.ros.org/Bags/Format/2.0.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from typing import IO, final

from gridslam.io.bags.chunks import DamageError, Head, Kind, Numbered, decompress
from gridslam.io.limits import UnpackingLimit

ROS1_MAGIC = b"#ROSBAG V2.0\n"
"""First bytes of a file."""

_LARGEST_HEADER = 1 << 24
_U32 = struct.Struct("<I")
_TIME = struct.Struct("<II")
_INDEX_ENTRY = struct.Struct("<III")
_BAG_HEADER = 3
_KINDS = {
    2: Kind.MESSAGE,
    _BAG_HEADER: Kind.OTHER,
    4: Kind.INDEX,
    5: Kind.CHUNK,
    6: Kind.OTHER,  # of the index of chunks
    7: Kind.DEFINITION,
}


@final
class Ros1Format:
    """Records of a header of named fields and data, see `ChunkFormat`."""

    is_ros1 = True

    def __init__(self) -> None:
        self.channels: dict[int, tuple[str, str]] = {}

    def heads(self, file: IO[bytes], position: int, size: int, *, inside: bool = False) -> Iterator[Head]:
        """Heads of records."""
        is_closed = inside
        position = position if inside else max(position, len(ROS1_MAGIC))
        while position < size:
            head = _read_head(file, position)
            op = _field(head.fields, b"op", 1)[0]
            if op not in _KINDS:
                raise DamageError(f"a record of unknown kind {op} at byte {position}")
            head = head._replace(kind=_KINDS[op])
            if op == _BAG_HEADER:
                if head.fields.get(b"encryptor"):
                    raise DamageError("it is encrypted, which is not supported")
                is_closed = any(_field(head.fields, b"index_pos", 8))
            elif head.kind is Kind.INDEX:  # the length of these is wrong in some bags, their count is right
                head = head._replace(end=head.begin + _INDEX_ENTRY.size * _number(head.fields, b"count"))
            if head.end <= size or head.kind is Kind.CHUNK:
                yield head
            if head.end > size:
                raise DamageError(f"a record at byte {position} is cut off")
            position = head.end
        if not is_closed:
            raise DamageError("it was not closed when it was recorded: it has no index")

    def define(self, head: Head, content: bytes) -> None:
        """Take in a connection."""
        topic = _field(head.fields, b"topic").decode("utf-8", "replace")
        kind = _field(_split_fields(content), b"type").decode("utf-8", "replace")
        name = "/".join(part for part in topic.split("/") if part)
        self.channels[_number(head.fields, b"conn")] = f"/{name}", kind

    def index(self, head: Head, content: bytes) -> tuple[int, list[int]]:
        """Connection and times."""
        times = [seconds * 10**9 + nanoseconds for seconds, nanoseconds, _ in _INDEX_ENTRY.iter_unpack(content)]
        return _number(head.fields, b"conn"), times

    def message(self, head: Head, content: bytes) -> Numbered:
        """Message and connection."""
        seconds, nanoseconds = _TIME.unpack(_field(head.fields, b"time", 8))
        return seconds * 10**9 + nanoseconds, _number(head.fields, b"conn"), content

    def unpack(self, head: Head, content: bytes, limit: UnpackingLimit) -> tuple[bytes, str]:
        """Records of a chunk."""
        size = _number(head.fields, b"size")
        data = decompress(_field(head.fields, b"compression"), content, limit, size)
        is_whole = len(content) == head.end - head.begin and len(data) == size
        return data, "" if is_whole else "it is cut off"


def _read_head(file: IO[bytes], position: int) -> Head:
    """Read the header of the record at `position`; leaves its data."""
    file.seek(position)
    head = file.read(4)
    length = int.from_bytes(head, "little")
    header = file.read(length + 4) if len(head) == 4 and length <= _LARGEST_HEADER else b""
    if not header:
        raise DamageError(f"there is no record at byte {position}")
    if len(header) != length + 4:
        raise DamageError(f"a record at byte {position} is cut off")
    begin = position + 8 + length
    end = begin + _U32.unpack_from(header, length)[0]
    return Head(Kind.OTHER, position, begin, end, _split_fields(header[:-4]))


def _split_fields(header: bytes) -> dict[bytes, bytes]:
    """Split a header into its fields."""
    found = {}
    position = 0
    while position < len(header):
        begin = position + 4
        position = begin + int.from_bytes(header[position:begin], "little")
        name, equals, value = header[begin:position].partition(b"=")
        if not equals or position > len(header):
            raise DamageError("a record's header is malformed")
        found[name] = value
    return found


def _field(fields: Mapping[bytes, bytes], name: bytes, size: int | None = None) -> bytes:
    """Return value of a field; raises DamageError where there is none of this size."""
    value = fields.get(name)
    if value is None or (size is not None and len(value) != size):
        raise DamageError(f"a record without a proper field '{name.decode()}'")
    return value


def _number(fields: Mapping[bytes, bytes], name: bytes) -> int:
    return int.from_bytes(_field(fields, name, 4), "little")
