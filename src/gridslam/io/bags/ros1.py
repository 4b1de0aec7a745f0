"""Reader of ROS 1 bags (format 2.0), a chunk at a time; their index may be wrong or missing.

A bag consists of records: a header of named fields, then data. rosbags keeps an index entry for each message and gives
up where one of them is wrong. Here the index of the chunks is all that is kept, the index of the messages is not looked
at, and where the index of the chunks does not hold, the file is walked through once to find them.

Source: wiki.ros.org/Bags/Format/2.0.
"""

from __future__ import annotations

import re
import struct
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from io import BytesIO
from pathlib import Path
from typing import IO, NamedTuple, final

from gridslam.errors import InputError
from gridslam.io.bags.source import (
    Chunk,
    DamageError,
    Message,
    count_topics,
    decompress,
    merge_chunks,
    truncation_error,
)
from gridslam.io.limits import UnpackingLimit, require_memory
from gridslam.io.log_statistics import Topic
from gridslam.io.text import open_for_reading

_MAGIC = b"#ROSBAG V2.0\n"
_LARGEST_HEADER = 1 << 24
_FARTHEST = 1 << 62
_U32 = struct.Struct("<I")
_PAIR = struct.Struct("<II")
_MESSAGE_HEADER = re.compile(
    rb"\x26\0\0\0(?:\x09\0\0\0conn=(.{4})|\x04\0\0\0op=\x02|\x0d\0\0\0time=(.{8})){3}(.{4})", re.DOTALL
)
"""A message record up to its data, with fields in any order: connection, time, length of the data."""


class _Op:
    """Kinds of records."""

    MESSAGE, BAG_HEADER, INDEX, CHUNK, CHUNK_INFO, CONNECTION = range(2, 8)


class _Record(NamedTuple):
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
        return int.from_bytes(self.field(name, 4), "little")

    def u64(self, name: bytes) -> int:
        """Read a field of eight bytes."""
        return int.from_bytes(self.field(name, 8), "little")

    def time_ns(self, name: bytes) -> int:
        """Read a time."""
        return _nanoseconds(self.field(name, 8))

    def text(self, name: bytes) -> str:
        """Read a field of text."""
        return self.field(name).decode("utf-8", "replace")

    def field(self, name: bytes, size: int | None = None) -> bytes:
        """Return value of a field; raises DamageError where there is none of this size."""
        value = self.fields.get(name)
        if value is None or (size is not None and len(value) != size):
            raise DamageError(f"a record without a proper field '{name.decode()}'")
        return value


class _Connection(NamedTuple):
    topic: str
    type: str


@final
class Ros1Bag:
    """A ROS 1 bag, see `BagSource`.

    Parameters
    ----------
    path : Path
        The file.
    keep_truncated : bool
        Whether a bag that was not closed, or ends early, or is damaged is read as far as it goes.

    Raises
    ------
    InputError
        The file is no such bag, or cut off or damaged.
    """

    def __init__(self, path: Path, *, keep_truncated: bool = False) -> None:
        """Read the index, or build it."""
        self.path = path
        self.is_ros1 = True
        self.is_truncated = False
        self.missing_files: tuple[str, ...] = ()
        self.bytes_read = 0
        self._keep_truncated = keep_truncated
        self._connections: dict[int, _Connection] = {}
        self._counts: Counter[int] = Counter()
        self._chunks: list[Chunk] = []
        with open_for_reading(path) as file:
            self.total_bytes = file.seek(0, 2)
            self._open(file)
        self._chunks.sort()
        self.topics: Mapping[str, Topic] = count_topics(
            (topic, kind, self._counts[number]) for number, (topic, kind) in sorted(self._connections.items())
        )

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """Yield messages of some topics in the order of recording."""
        numbers = {
            number: connection.topic
            for number, connection in self._connections.items()
            if connection.topic in topics and connection.type == self.topics[connection.topic].type
        }
        wanted = {number.to_bytes(4, "little"): topic for number, topic in numbers.items()}
        chunks = [chunk for chunk in self._chunks if not chunk.connections.isdisjoint(numbers)]
        self.bytes_read = 0
        limit = UnpackingLimit(self.total_bytes)
        with open_for_reading(self.path) as file:
            merged = merge_chunks((chunk.start_ns, self._wanted(file, chunk, wanted, limit)) for chunk in chunks)
            try:
                yield from merged
            except DamageError as damage:
                self._cut(str(damage))
        self.bytes_read = self.total_bytes

    def _wanted(self, file: IO[bytes], chunk: Chunk, topics: dict[bytes, str], limit: UnpackingLimit) -> list[Message]:
        found: list[Message] = []
        try:
            data, whole = self._chunk(file, _read_record(file, chunk.position, _Op.CHUNK), limit)
            self.bytes_read = max(self.bytes_read, file.tell())
            for number, time_ns, begin, end in _messages_in(data):
                topic = topics.get(number)
                if topic is not None:
                    found.append((time_ns, topic, data[begin:end]))
            if not whole:
                raise DamageError("the file ends within a chunk")
        except DamageError as damage:
            self._cut(f"the chunk at byte {chunk.position} is damaged ({damage})")
        return found

    def _cut(self, problem: str) -> None:
        """Record that a part is missing, or raise if that is not accepted."""
        self.is_truncated = True
        if not self._keep_truncated:
            raise truncation_error(self.path, problem)

    def _open(self, file: IO[bytes]) -> None:
        file.seek(0)
        magic = file.read(len(_MAGIC))
        if magic != _MAGIC:
            remedy = " (rosbag filter OLD.bag NEW.bag True rewrites it)" if magic.startswith(b"#ROSBAG V1") else ""
            problem = f"expected a ROS 1 bag of version 2.0, got one that begins with {magic!r}{remedy}"
            raise InputError(self.path, problem)
        try:
            header = _read_record(file, len(_MAGIC))
            if header.fields.get(b"encryptor"):
                raise InputError(self.path, "the bag is encrypted, which is not supported")
            index_position = header.u64(b"index_pos")
            if index_position:
                self._read_index(file, index_position, header.u32(b"conn_count"), header.u32(b"chunk_count"))
                return
            problem = "the bag was not closed when it was recorded: it has no index"
        except DamageError:
            problem = ""
        self._connections.clear()
        self._chunks.clear()
        self._counts.clear()
        problem = self._walk(file) or problem or ("" if self._connections else "the bag ends with its first line")
        if problem:
            self._cut(problem)

    def _read_index(self, file: IO[bytes], position: int, connections: int, chunks: int) -> None:
        """Take connections and chunks from the index at the file's end."""
        for _ in range(connections):
            record = _read_record(file, position, _Op.CONNECTION)
            self._connect(record, self._data(file, record))
            position = record.end
        for _ in range(chunks):
            record = _read_record(file, position, _Op.CHUNK_INFO)
            data = self._data(file, record)
            if record.u32(b"ver") != 1 or len(data) != 8 * record.u32(b"count"):
                raise DamageError("an index of chunks that is malformed")
            counts = dict(_PAIR.iter_unpack(data))
            if not counts.keys() <= self._connections.keys():
                raise DamageError("an index of chunks that names an unknown connection")
            self._counts.update(counts)
            place = record.u64(b"chunk_pos")
            _read_record(file, place, _Op.CHUNK)
            self._chunks.append(Chunk(record.time_ns(b"start_time"), place, frozenset(counts)))
            position = record.end

    def _walk(self, file: IO[bytes]) -> str:
        """Find connections and chunks by reading the file from its start; return the error that stopped it early."""
        position = len(_MAGIC)
        limit = UnpackingLimit(self.total_bytes)
        while position < self.total_bytes:
            try:
                record = _read_record(file, position)
                if record.op == _Op.CHUNK:
                    self._walk_chunk(file, record, position, limit)
                elif record.op == _Op.CONNECTION:
                    self._connect(record, self._data(file, record))
                elif record.op not in (_Op.BAG_HEADER, _Op.INDEX, _Op.CHUNK_INFO):
                    raise DamageError(f"a record of unknown kind {record.op}")
                position = record.end
                if record.op == _Op.INDEX:  # the length of these is wrong in some bags, their count is right
                    position = record.begin + 12 * record.u32(b"count")
            except DamageError as damage:
                return f"the file is damaged or cut off at byte {position} ({damage})"
        return "" if position == self.total_bytes else "the file is cut off at its end"

    def _walk_chunk(self, file: IO[bytes], record: _Record, position: int, limit: UnpackingLimit) -> None:
        data, whole = self._chunk(file, record, limit)
        times: list[int] = []
        numbers: Counter[int] = Counter()
        try:
            for number, time_ns, _, _ in _messages_in(data, self._connect):
                times.append(time_ns)
                numbers[int.from_bytes(number, "little")] += 1
        finally:
            if times:
                self._chunks.append(Chunk(min(times), position, frozenset(numbers)))
                self._counts.update(numbers)
        if not whole:
            raise DamageError("the file ends within a chunk")

    def _chunk(self, file: IO[bytes], record: _Record, limit: UnpackingLimit) -> tuple[bytes, bool]:
        """Decompressed data of a chunk, and whether they are all there."""
        raw = self._data(file, record, cut=True)
        size = record.u32(b"size")
        data = decompress(record.field(b"compression"), raw, limit, size)
        return data, len(raw) == record.end - record.begin and len(data) == size

    def _data(self, file: IO[bytes], record: _Record, *, cut: bool = False) -> bytes:
        file.seek(record.begin)
        size = min(record.end, self.total_bytes) - record.begin
        require_memory(self.path, f"the record at byte {record.begin}", size)
        data = file.read(size)
        if len(data) != record.end - record.begin and not cut:
            raise DamageError("a record is cut off")
        return data

    def _connect(self, record: _Record, data: bytes) -> None:
        """Add a connection."""
        described = _Record(_fields_of(data), 0, 0)
        topic = "/".join(part for part in record.text(b"topic").split("/") if part)
        self._connections[record.u32(b"conn")] = _Connection(f"/{topic}", described.text(b"type"))


def _fields_of(header: bytes) -> dict[bytes, bytes]:
    """Split a header into its fields."""
    found = {}
    position = 0
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


def _read_record(file: IO[bytes], position: int, op: int = 0) -> _Record:
    """Read the header of the record at `position`, which must be of kind `op` if that is given; leaves its data."""
    if position > _FARTHEST:
        raise DamageError("there is no record")
    file.seek(position)
    head = file.read(4)
    length = int.from_bytes(head, "little") if len(head) == 4 else _LARGEST_HEADER + 1
    if length > _LARGEST_HEADER:
        raise DamageError("there is no record")
    header = file.read(length + 4)
    if len(header) != length + 4:
        raise DamageError("a record is cut off")
    begin = position + 8 + length
    record = _Record(_fields_of(header[:-4]), begin, begin + int.from_bytes(header[-4:], "little"))
    if op and record.op != op:
        raise DamageError(f"expected a record of kind {op}, got {record.op}")
    return record


def _messages_in(
    data: bytes, connect: Callable[[_Record, bytes], None] | None = None
) -> Iterator[tuple[bytes, int, int, int]]:
    """Yield of each message in a chunk's data its connection's number (packed), time in ns, begin and end.

    What stands there of connections is handed to `connect`. Raises DamageError where a record is malformed or cut off.
    """
    match = _MESSAGE_HEADER.match
    stream = BytesIO(data)
    position = 0
    size = len(data)
    while position < size:
        found = match(data, position)
        if found is not None and found[1] is not None and found[2] is not None:
            begin = found.end()
            position = begin + _U32.unpack(found[3])[0]
            if position <= size:
                yield found[1], _nanoseconds(found[2]), begin, position
                continue
        else:
            record = _read_record(stream, position)
            position = record.end
            if position <= size:
                if record.op == _Op.MESSAGE:
                    yield record.field(b"conn", 4), record.time_ns(b"time"), record.begin, record.end
                elif record.op != _Op.CONNECTION:
                    raise DamageError(f"a chunk holds a record of kind {record.op}")
                elif connect is not None:
                    connect(record, data[record.begin : record.end])
                continue
        raise DamageError("a record is cut off")


def _nanoseconds(time: bytes) -> int:
    seconds, nanoseconds = _PAIR.unpack(time)
    return int(seconds * 1_000_000_000 + nanoseconds)
