"""mcap files of ROS 2 bags, a chunk at a time; with or without their summary, and as far as they go where they are cut.

The heads of all records are looked at once. What follows a chunk is an index of its messages by channel: it is counted,
so that no chunk is unpacked that need not be. A chunk without it is unpacked.

Source: mcap.dev/spec.
"""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Collection, Iterator
from io import BytesIO
from pathlib import Path
from typing import IO, NamedTuple, TypeAlias, final
from zlib import crc32

from gridslam.io.bags.source import Chunk, DamageError, Message, count_topics, decompress, merge_chunks
from gridslam.io.limits import UnpackingLimit

MCAP_MAGIC = b"\x89MCAP0\r\n"
"""First bytes of a file."""

_LATEST_NS = (1 << 63) - 1
_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _INDEX = 2, 3, 4, 5, 6, 7
_RECORD_HEAD = struct.Struct("<BQ")
_MESSAGE_HEAD = struct.Struct("<HIQQ")
_CHUNK_HEAD = struct.Struct("<QQQII")
_INDEX_HEAD = struct.Struct("<HI")
_TIME_BYTES = 16  # of an entry of the index of a chunk


class _Channel(NamedTuple):
    topic: str
    type: str
    encoding: str


class _Head(NamedTuple):
    """Kind of a record, and where its content begins and ends."""

    op: int
    begin: int
    end: int


_Numbered: TypeAlias = tuple[int, int, bytes]
"""Time of recording, ns, number of the channel, and data."""


@final
class McapFile:
    """An mcap file.

    Attributes
    ----------
    problem : str
        What stopped the reading before the file's end; empty where nothing did.
    """

    def __init__(self, path: Path) -> None:
        """Look at the heads of the records."""
        self.problem = ""
        self._path = path
        self._size = path.stat().st_size
        self._schemas: dict[int, str] = {}
        self._channels: dict[int, _Channel] = {}
        self._chunks: list[Chunk] = []
        self._counts: Counter[int] = Counter()
        self.start_ns = _LATEST_NS
        self.end_ns = 0
        with path.open("rb") as file:
            self._scan(file, UnpackingLimit(self._size))
            if self._counts.keys() - self._channels.keys():  # they are defined in chunks alone
                limit = UnpackingLimit(self._size)
                for chunk in self._chunks:
                    self._messages_in(file, chunk, limit)
        self._chunks.sort()
        self.is_ros1 = any(channel.encoding == "ros1" for channel in self._channels.values())
        self.topics = count_topics((topic, kind, self._counts[k]) for k, (topic, kind, _) in self._channels.items())

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """Yield messages of some topics, by the time of their recording.

        Raises DamageError at the end where a chunk is damaged, and at once where chunks take too much memory.
        """
        wanted = {
            number: channel.topic
            for number, channel in self._channels.items()
            if channel.topic in topics and channel.type == self.topics[channel.topic].type
        }
        before = self.problem
        self.problem = ""
        limit = UnpackingLimit(self._size)
        with self._path.open("rb") as file:
            yield from merge_chunks(
                (
                    chunk.start_ns,
                    [
                        (time_ns, wanted[number], data)
                        for time_ns, number, data in self._messages_in(file, chunk, limit)
                        if number in wanted
                    ],
                )
                for chunk in self._chunks
                if not chunk.connections.isdisjoint(wanted)
            )
        problem = self.problem
        self.problem = before or problem
        if problem:
            raise DamageError(problem)

    def _scan(self, file: IO[bytes], limit: UnpackingLimit) -> None:
        """Find channels and chunks; a message that is in none counts as a chunk of its own."""
        chunk: Chunk | None = None  # until its index has been counted
        counted: set[int] = set()
        file.seek(len(MCAP_MAGIC))
        try:
            for head in _heads(file, self._size):
                if head.op == _INDEX:
                    number, length = _INDEX_HEAD.unpack(file.read(_INDEX_HEAD.size))
                    self._counts[number] += length // _TIME_BYTES
                    counted.add(number)
                    continue
                self._close(file, chunk, counted, limit)
                chunk = None
                counted = set()
                if head.op == _CHUNK:
                    start_ns, end_ns, *_ = _CHUNK_HEAD.unpack(file.read(_CHUNK_HEAD.size))
                    chunk = Chunk(min(start_ns, _LATEST_NS), head.begin - _RECORD_HEAD.size, frozenset())
                    self.end_ns = max(self.end_ns, min(end_ns, _LATEST_NS))
                elif head.op == _MESSAGE:
                    number, _, time_ns, _ = _MESSAGE_HEAD.unpack(file.read(_MESSAGE_HEAD.size))
                    self._counts[number] += 1
                    self._add(Chunk(time_ns, head.begin - _RECORD_HEAD.size, frozenset([number])))
                elif head.op in (_SCHEMA, _CHANNEL):
                    self._define(head.op, file.read(head.end - head.begin))
        except (DamageError, struct.error) as error:
            self.problem = self.problem or str(error)
        self._close(file, chunk, counted, limit)

    def _close(self, file: IO[bytes], chunk: Chunk | None, counted: set[int], limit: UnpackingLimit) -> None:
        """Add a chunk whose messages have been counted by the index behind it, or else count them in it."""
        if chunk is None:
            return
        if not counted:
            messages = self._messages_in(file, chunk, limit)
            found = Counter(number for _, number, _ in messages)
            self._counts += found
            counted = set(found)
            chunk = chunk._replace(start_ns=min([time_ns for time_ns, _, _ in messages], default=chunk.start_ns))
            self.end_ns = max([self.end_ns, *(time_ns for time_ns, _, _ in messages)])
        self._add(chunk._replace(connections=frozenset(counted)))

    def _add(self, chunk: Chunk) -> None:
        self.start_ns = min(self.start_ns, chunk.start_ns)
        self.end_ns = max(self.end_ns, chunk.start_ns)
        self._chunks.append(chunk)

    def _messages_in(self, file: IO[bytes], chunk: Chunk, limit: UnpackingLimit) -> list[_Numbered]:
        """Return messages of a chunk, or of the record that is a message, as far as they can be read."""
        place = file.tell()
        found: list[_Numbered] = []
        try:
            file.seek(chunk.position)
            op, length = _RECORD_HEAD.unpack(file.read(_RECORD_HEAD.size))
            begin = file.tell()
            content = file.read(min(length, self._size - begin))
            if op == _CHUNK:
                self._unpack(content, limit, found)
            else:
                found.append(_message(content))
        except (DamageError, struct.error) as error:
            self.problem = self.problem or str(error)
        file.seek(place)
        return found

    def _unpack(self, content: bytes, limit: UnpackingLimit, found: list[_Numbered]) -> None:
        """Add the messages in a chunk; raises DamageError, after the readable ones, if it is truncated or damaged."""
        _, _, size, crc, length = _CHUNK_HEAD.unpack_from(content)
        begin = _CHUNK_HEAD.size + length
        data = decompress(content[_CHUNK_HEAD.size : begin], content[begin + 8 :], limit, size)
        stream = BytesIO(data)
        for head in _heads(stream, len(data), footer=False):
            record = stream.read(head.end - head.begin)
            if head.op == _MESSAGE:
                found.append(_message(record))
            elif head.op in (_SCHEMA, _CHANNEL):
                self._define(head.op, record)
        if len(data) != size:
            raise DamageError("a chunk is cut off")
        if crc and crc32(data) != crc:
            raise DamageError("the checksum of a chunk is wrong")

    def _define(self, op: int, content: bytes) -> None:
        """Take in a schema or a channel."""
        number, kind = struct.unpack_from("<HH", content)
        if op == _SCHEMA:
            self._schemas[number] = _texts(content, 2, 1)[0]
        else:
            topic, encoding = _texts(content, 4, 2)
            self._channels[number] = _Channel(topic, self._schemas.get(kind, ""), encoding)


def _message(content: bytes) -> _Numbered:
    number, _, time_ns, _ = _MESSAGE_HEAD.unpack_from(content)
    if time_ns > _LATEST_NS:
        raise DamageError(f"a message recorded at {time_ns} ns, which 64 bits with a sign do not hold")
    return time_ns, number, content[_MESSAGE_HEAD.size :]


def _heads(file: IO[bytes], size: int, *, footer: bool = True) -> Iterator[_Head]:
    """Heads of the records up to the `footer`, or the end of a chunk; the file is at the content of each.

    Raises DamageError where the file ends before; a chunk that is cut off is given ahead of that.
    """
    position = file.tell()
    while position < size:
        head = file.read(_RECORD_HEAD.size)
        if len(head) < _RECORD_HEAD.size:
            raise DamageError("a record is cut off")
        op, length = _RECORD_HEAD.unpack(head)
        if op == _FOOTER:
            return
        begin = position + _RECORD_HEAD.size
        position = begin + length
        if position <= size or op == _CHUNK:
            yield _Head(op, begin, position)
        if position > size:
            raise DamageError(f"a record at byte {begin - _RECORD_HEAD.size} is cut off")
        file.seek(position)
    if footer:
        raise DamageError("the file ends without a footer: it was not closed when it was recorded")


def _texts(content: bytes, begin: int, count: int) -> list[str]:
    found = []
    for _ in range(count):
        end = begin + 4 + struct.unpack_from("<I", content, begin)[0]
        found.append(content[begin + 4 : end].decode("utf-8", "replace"))
        begin = end
    return found
