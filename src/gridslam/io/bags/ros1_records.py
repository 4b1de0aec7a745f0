"""Records of ROS 1 bags (format 2.0): a header of named fields, then data.

Source: wiki.ros.org/Bags/Format/2.0.
"""

from __future__ import annotations

import bz2
import re
import struct
from collections.abc import Callable, Iterator
from typing import IO, NamedTuple

from gridslam.io.bags.source import DamageError

__all__ = ["Op", "Ros1Record", "chunk_data", "messages_in", "number_of", "read_record"]

_LARGEST_HEADER = 1 << 24
_U32, _U64, _PAIR = struct.Struct("<I"), struct.Struct("<Q"), struct.Struct("<II")

_MESSAGE_HEADER = re.compile(
    rb"\x26\0\0\0(?:\x09\0\0\0conn=(.{4})|\x04\0\0\0op=\x02|\x0d\0\0\0time=(.{8})){3}(.{4})", re.DOTALL
)
"""A message record up to its data, whatever the order of its fields: connection, time, length of the data."""


class Op:
    """Kinds of records."""

    MESSAGE, BAG_HEADER, INDEX, CHUNK, CHUNK_INFO, CONNECTION = range(2, 8)


class Ros1Record(NamedTuple):
    """A record's header fields, and where its data begin and end."""

    fields: dict[bytes, bytes]
    begin: int
    end: int

    @property
    def op(self) -> int:
        """Kind of the record; 0 if it is not given."""
        return (self.fields.get(b"op") or b"\0")[0]

    def u32(self, name: bytes) -> int:
        """Read a field of four bytes."""
        return int(_U32.unpack(self.field(name, 4))[0])

    def u64(self, name: bytes) -> int:
        """Read a field of eight bytes."""
        return int(_U64.unpack(self.field(name, 8))[0])

    def time_ns(self, name: bytes) -> int:
        """Read a time."""
        return _nanoseconds(self.field(name, 8))

    def text(self, name: bytes) -> str:
        """Read a field of text."""
        return self.field(name).decode("utf-8", "replace")

    def field(self, name: bytes, size: int | None = None) -> bytes:
        """Value of a field; raises DamageError where there is none of this size."""
        value = self.fields.get(name)
        if value is None or (size is not None and len(value) != size):
            raise DamageError(f"a record without a proper field '{name.decode()}'")
        return value


def fields_of(header: bytes) -> dict[bytes, bytes]:
    """Split a header into its fields."""
    found, position = {}, 0
    while position < len(header):
        if position + 4 > len(header):
            raise DamageError("a record's header ends within a field")
        begin = position + 4
        position = begin + _U32.unpack_from(header, position)[0]
        name, equals, value = header[begin:position].partition(b"=")
        if not equals or position > len(header):
            raise DamageError("a record's header is malformed")
        found[name] = value
    return found


def number_of(packed: bytes) -> int:
    """Read the number of a connection as it stands in messages' headers."""
    return int(_U32.unpack(packed)[0])


def read_record(file: IO[bytes], position: int, op: int = 0) -> Ros1Record:
    """Read the header of the record at `position`, which must be of kind `op` if that is given; leaves its data."""
    file.seek(position)
    head = file.read(4)
    length = number_of(head) if len(head) == 4 else _LARGEST_HEADER + 1
    if length > _LARGEST_HEADER:
        raise DamageError("there is no record")
    header = file.read(length + 4)
    if len(header) != length + 4:
        raise DamageError("a record is cut off")
    begin = position + 8 + length
    record = Ros1Record(fields_of(header[:-4]), begin, begin + number_of(header[-4:]))
    if op and record.op != op:
        raise DamageError(f"expected a record of kind {op}, got {record.op}")
    return record


def chunk_data(compression: bytes, data: bytes, size: int) -> bytes:
    """Decompress a chunk; gives less than `size` bytes where `data` is cut off."""
    try:
        if compression == b"bz2":
            return bz2.BZ2Decompressor().decompress(data, size)
        if compression == b"lz4":
            from lz4.frame import LZ4FrameDecompressor

            found: bytes = LZ4FrameDecompressor().decompress(data, size)
            return found
    except (OSError, ValueError, EOFError, RuntimeError) as error:
        raise DamageError(f"its data cannot be decompressed: {error}") from None
    if compression != b"none":
        raise DamageError(f"it is compressed by '{compression.decode(errors='replace')}', which is not known")
    return data


def messages_in(
    data: bytes, connect: Callable[[Ros1Record, bytes], None] | None = None
) -> Iterator[tuple[bytes, int, int, int]]:
    """Yield of each message in a chunk's data its connection's number (packed), time in ns, begin and end.

    What stands there of connections is handed to `connect`. Raises DamageError where a record is malformed or cut off.
    """
    match, position, size = _MESSAGE_HEADER.match, 0, len(data)
    while position < size:
        found = match(data, position)
        if found is not None and found[1] is not None and found[2] is not None:
            begin = found.end()
            position = begin + _U32.unpack(found[3])[0]
            if position <= size:
                yield found[1], _nanoseconds(found[2]), begin, position
                continue
        else:
            record = _record_in(data, position)
            position = record.end
            if position <= size:
                if record.op == Op.MESSAGE:
                    yield record.field(b"conn", 4), record.time_ns(b"time"), record.begin, record.end
                elif record.op != Op.CONNECTION:
                    raise DamageError(f"a chunk holds a record of kind {record.op}")
                elif connect is not None:
                    connect(record, data[record.begin : record.end])
                continue
        raise DamageError("a record is cut off")


def _record_in(data: bytes, position: int) -> Ros1Record:
    try:
        (length,) = _U32.unpack_from(data, position)
        begin = position + 8 + length
        (size,) = _U32.unpack_from(data, begin - 4)
    except struct.error:
        raise DamageError("a record is cut off") from None
    return Ros1Record(fields_of(data[position + 4 : begin - 4]), begin, begin + size)


def _nanoseconds(time: bytes) -> int:
    seconds, nanoseconds = _PAIR.unpack(time)
    return int(seconds * 1_000_000_000 + nanoseconds)
