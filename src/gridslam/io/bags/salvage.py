"""Readers of the files of ROS 2 bags that need no index: for those that were not closed, or end early, or are damaged.

Source: mcap.dev/spec; sqlite.org (a table's rows lie in the order of their ids, which is that of the recording).
"""

from __future__ import annotations

import sqlite3
import struct
from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import closing
from io import BytesIO
from pathlib import Path
from typing import IO, Any, NamedTuple, Protocol, final
from urllib.parse import quote

from gridslam.io.bags import zstd
from gridslam.io.bags.ros1_records import chunk_data
from gridslam.io.bags.source import DamageError, Message, merge_chunks
from gridslam.io.log_statistics import Topic

__all__ = ["SalvagedMcap", "SalvagedSqlite", "SalvagedStorage"]

_MCAP_MAGIC_BYTES = 8
_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK = 2, 3, 4, 5, 6
_MESSAGE_HEAD = struct.Struct("<HIQQ")
_CHUNK_HEAD = struct.Struct("<QQQII")


class SalvagedStorage(Protocol):
    """What can be read of a file.

    Attributes
    ----------
    topics : dict of str to Topic
        All that were found.
    is_ros1 : bool
        Whether the messages are serialized as in ROS 1.
    start_ns, end_ns : int
        Times of the first and the last message.
    problem : str
        What stopped the reading; empty where all of the file can be read.
    """

    topics: dict[str, Topic]
    is_ros1: bool
    start_ns: int
    end_ns: int
    problem: str

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """Messages of some topics, as far as they can be read."""


_Numbered = tuple[int, int, bytes]
"""Time of recording, ns, number of the channel, and data."""


class _Channel(NamedTuple):
    topic: str
    type: str
    encoding: str


@final
class SalvagedMcap:
    """An mcap file, see `SalvagedStorage`, read from its start without its summary."""

    def __init__(self, path: Path) -> None:
        """Read it through once."""
        self.problem = ""
        self._path = path
        self._schemas: dict[int, str] = {}
        self._channels: dict[int, _Channel] = {}
        counts: Counter[int] = Counter()
        self.start_ns, self.end_ns = (1 << 63) - 1, 0
        for start_ns, messages in self._batches():
            times = [time_ns for time_ns, _, _ in messages]
            self.start_ns, self.end_ns = min(self.start_ns, start_ns, *times), max(self.end_ns, *times, 0)
            counts.update(number for _, number, _ in messages)
        self.is_ros1 = any(channel.encoding == "ros1" for channel in self._channels.values())
        self.topics: dict[str, Topic] = {}
        for number, channel in self._channels.items():
            before = self.topics.get(channel.topic, Topic(channel.type, 0))
            self.topics[channel.topic] = Topic(before.type, before.messages + counts[number])

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """Messages of some topics, by the time of their recording."""
        wanted = {
            number: channel.topic
            for number, channel in self._channels.items()
            if channel.topic in topics and channel.type == self.topics[channel.topic].type
        }
        yield from merge_chunks(
            (start_ns, [(time_ns, wanted[number], data) for time_ns, number, data in messages if number in wanted])
            for start_ns, messages in self._batches()
        )

    def _batches(self) -> Iterator[tuple[int, list[_Numbered]]]:
        """Time of the first message and all messages of each chunk, and of each message that is in none."""
        with self._path.open("rb") as file:
            size = file.seek(0, 2)
            file.seek(_MCAP_MAGIC_BYTES)
            try:
                for op, content in _records(file, size):
                    if op == _CHUNK:
                        yield self._chunk(content)
                    elif (message := self._message(op, content)) is not None:
                        yield message[0], [message]
            except (DamageError, struct.error) as error:
                self.problem = str(error)

    def _chunk(self, content: bytes) -> tuple[int, list[_Numbered]]:
        """Time of the first message in a chunk, and its messages as far as they can be read."""
        found: list[_Numbered] = []
        start_ns, _, size, _, length = _CHUNK_HEAD.unpack_from(content)
        begin = _CHUNK_HEAD.size + length
        compression, packed = content[_CHUNK_HEAD.size : begin], content[begin + 8 :]
        try:
            if compression == b"zstd":
                data = zstd.decompress(packed, size)
            else:
                data = chunk_data(compression or b"none", packed, size)
            for op, record in _records(BytesIO(data), len(data), footer=False):
                message = self._message(op, record)
                if message is not None:
                    found.append(message)
            if len(data) != size:
                raise DamageError("a chunk is cut off")
        except (DamageError, struct.error) as error:
            self.problem = str(error)
        return start_ns, found

    def _message(self, op: int, content: bytes) -> _Numbered | None:
        """The message in a record; other records are processed, and None is returned."""
        if op == _MESSAGE:
            number, _, time_ns, _ = _MESSAGE_HEAD.unpack_from(content)
            return time_ns, number, content[_MESSAGE_HEAD.size :]
        number, kind = struct.unpack_from("<HH", content)
        if op == _SCHEMA:
            self._schemas[number] = _texts(content, 2, 1)[0]
        elif op == _CHANNEL:
            topic, encoding = _texts(content, 4, 2)
            self._channels[number] = _Channel(topic, self._schemas.get(kind, ""), encoding)
        return None


def _records(file: IO[bytes], size: int, *, footer: bool = True) -> Iterator[tuple[int, bytes]]:
    """Kind and content of the records up to the `footer`, or the end of a chunk; only of those that matter here.

    Raises DamageError where the file ends before; a chunk that is cut off is given ahead of that.
    """
    while head := file.read(9):
        if len(head) < 9:
            raise DamageError("a record is cut off")
        op, length = struct.unpack("<BQ", head)
        if op == _FOOTER:
            return
        begin = file.tell()
        if op in (_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK):
            content = file.read(min(length, size - begin))
            if len(content) == length or op == _CHUNK:
                yield op, content
        file.seek(begin + min(length, size))
        if begin + length > size:
            raise DamageError(f"a record at byte {begin - 9} is cut off")
    if footer:
        raise DamageError("the file ends without a footer: it was not closed when it was recorded")


def _texts(content: bytes, begin: int, count: int) -> list[str]:
    found = []
    for _ in range(count):
        end = begin + 4 + struct.unpack_from("<I", content, begin)[0]
        found.append(content[begin + 4 : end].decode("utf-8", "replace"))
        begin = end
    return found


@final
class SalvagedSqlite:
    """An SQLite file, see `SalvagedStorage`, read row by row up to the first page that is missing or damaged."""

    def __init__(self, path: Path) -> None:
        """Read it through once."""
        self.is_ros1 = False
        self.problem = ""
        self._path = path
        self._topics: dict[int, str] = {}
        self.topics: dict[str, Topic] = {}
        counts: Counter[int] = Counter()
        self.start_ns, self.end_ns = (1 << 63) - 1, 0
        types = {row[0]: (str(row[1]), str(row[2])) for row in self._rows(1, "SELECT id, name, type FROM topics")}
        for number, time_ns in self._rows(2, "SELECT topic_id, timestamp FROM messages"):
            counts[number] += 1
            self.start_ns, self.end_ns = min(self.start_ns, time_ns), max(self.end_ns, time_ns)
        for number, (name, kind) in types.items():
            self._topics[number] = name
            self.topics[name] = Topic(kind, counts[number])

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """Messages of some topics, in the order of their rows."""
        for time_ns, number, data in self._rows(2, "SELECT timestamp, topic_id, data FROM messages"):
            topic = self._topics.get(number, "")
            if topic in topics and isinstance(data, bytes):
                yield time_ns, topic, data

    def _rows(self, numbers: int, query: str) -> Iterator[Any]:
        """Rows whose first columns are `numbers` whole numbers, as they are where nothing is damaged."""
        try:
            with closing(sqlite3.connect(f"file:{quote(str(self._path))}?mode=ro&immutable=1", uri=True)) as connection:
                connection.execute("PRAGMA writable_schema=ON")  # else a file that is cut off is refused as a whole
                for row in connection.execute(query):
                    if not all(isinstance(value, int) for value in row[:numbers]):
                        raise DamageError("a row is damaged")
                    yield row
        except (DamageError, sqlite3.Error, UnicodeError) as error:  # the last: a message that quotes damaged text
            self.problem = self.problem or str(error)
