"""The records of mcap files, in which ROS 2 writes bags; ROS 1 bags that were converted, too.

Source: mcap.dev/spec.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import IO, final
from zlib import crc32

from gridslam.io.bags.chunks import LATEST_NS, DamageError, Head, Kind, Numbered, decompress
from gridslam.io.limits import UnpackingLimit

MCAP_MAGIC = b"\x89MCAP0\r\n"
"""First bytes of a file."""

_FOOTER = 2
_CHANNEL = b"channel"
_KINDS = {3: Kind.DEFINITION, 4: Kind.DEFINITION, 5: Kind.MESSAGE, 6: Kind.CHUNK, 7: Kind.INDEX}
_NOTHING: dict[bytes, bytes] = {}
_OF_CHANNEL = {_CHANNEL: b""}
_RECORD_HEAD = struct.Struct("<BQ")
_MESSAGE_HEAD = struct.Struct("<HIQQ")
_CHUNK_HEAD = struct.Struct("<QQQII")
_INDEX_HEAD = struct.Struct("<HI")
_INDEX_ENTRY = struct.Struct("<QQ")


@final
class McapFormat:
    """Records of a kind, a length and content, see `ChunkFormat`."""

    def __init__(self) -> None:
        self.channels: dict[int, tuple[str, str]] = {}
        self.is_ros1 = False
        self._schemas: dict[int, str] = {}

    def heads(self, file: IO[bytes], position: int, size: int, *, inside: bool = False) -> Iterator[Head]:
        """Heads of records."""
        position = position if inside else max(position, len(MCAP_MAGIC))
        while position < size:
            file.seek(position)
            head = file.read(_RECORD_HEAD.size)
            if len(head) < _RECORD_HEAD.size:
                raise DamageError(f"a record at byte {position} is cut off")
            op, length = _RECORD_HEAD.unpack(head)
            if op == _FOOTER:
                return
            begin = position + _RECORD_HEAD.size
            end = begin + length
            kind = _KINDS.get(op, Kind.OTHER)
            if end <= size or kind is Kind.CHUNK:
                yield Head(kind, position, begin, end, _OF_CHANNEL if op == 4 else _NOTHING)
            if end > size:
                raise DamageError(f"a record at byte {position} is cut off")
            position = end
        if not inside:
            raise DamageError("it ends without a footer: it was not closed when it was recorded")

    def define(self, head: Head, content: bytes) -> None:
        """Take in a schema or a channel."""
        number, kind = struct.unpack_from("<HH", content)
        if _CHANNEL in head.fields:
            topic, encoding = _texts(content, 4, 2)
            self.channels[number] = topic, self._schemas.get(kind, "")
            self.is_ros1 |= encoding == "ros1"
        else:
            (self._schemas[number],) = _texts(content, 2, 1)

    def index(self, head: Head, content: bytes) -> tuple[int, list[int]]:
        """Channel and times."""
        number, length = _INDEX_HEAD.unpack_from(content)
        entries = content[_INDEX_HEAD.size : _INDEX_HEAD.size + length]
        return number, [min(time_ns, LATEST_NS) for time_ns, _ in _INDEX_ENTRY.iter_unpack(entries)]

    def message(self, head: Head, content: bytes) -> Numbered:
        """Message and channel."""
        number, _, time_ns, _ = _MESSAGE_HEAD.unpack_from(content)
        if time_ns > LATEST_NS:
            raise DamageError(f"a message recorded at {time_ns} ns, which 64 bits with a sign do not hold")
        return time_ns, number, content[_MESSAGE_HEAD.size :]

    def unpack(self, head: Head, content: bytes, limit: UnpackingLimit) -> tuple[bytes, str]:
        """Records of a chunk."""
        _, _, size, crc, length = _CHUNK_HEAD.unpack_from(content)
        begin = _CHUNK_HEAD.size + length
        data = decompress(content[_CHUNK_HEAD.size : begin], content[begin + 8 :], limit, size)
        if len(data) != size:
            return data, "it is cut off"
        return data, "its checksum is wrong" if crc and crc32(data) != crc else ""


def _texts(content: bytes, begin: int, count: int) -> list[str]:
    found = []
    for _ in range(count):
        end = begin + 4 + struct.unpack_from("<I", content, begin)[0]
        found.append(content[begin + 4 : end].decode("utf-8", "replace"))
        begin = end
    return found
