"""Reader of ROS 2 bags: a folder, or a single file of it (SQLite or mcap), also compressed by zstd.

rosbags reads what is whole. Files that were not closed, or end early, or are damaged are read here without their index.

Source: mcap.dev/spec; sqlite.org (a table's rows lie in the order of their ids, which is that of the recording).
"""

from __future__ import annotations

import sqlite3
import struct
import weakref
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from contextlib import closing
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO, Any, NamedTuple, TypeAlias, final
from urllib.parse import quote

from gridslam.errors import InputError
from gridslam.io.bags.source import (
    ZSTD_MAGIC,
    DamageError,
    Message,
    count_topics,
    decompress,
    decompress_file,
    merge_chunks,
    truncation_error,
)
from gridslam.io.log_statistics import Topic
from gridslam.io.text import open_for_reading

__all__ = ["Ros2Bag"]

_MCAP = b"\x89MCAP0\r\n"
_SQLITE = b"SQLite format 3\0"
_NAMES = ("*.mcap", "*.db3", "*.mcap.zst*", "*.db3.zst*")
_LATEST_NS = (1 << 63) - 1
_FOOTER = 2
_SCHEMA = 3
_CHANNEL = 4
_MESSAGE = 5
_CHUNK = 6
_MESSAGE_HEAD = struct.Struct("<HIQQ")
_CHUNK_HEAD = struct.Struct("<QQQII")


@final
class Ros2Bag:
    """A ROS 2 bag, see `BagSource`: its files one after another, by the time of their first message.

    Parameters
    ----------
    path : Path
        The bag's folder, whether there is a metadata.yaml in it or not, or one of its files.
    keep_truncated : bool
        Whether a file that was not closed, or ends early, or is damaged is read as far as it goes.

    Raises
    ------
    InputError
        There is no such bag, or it is cut off or damaged.
    """

    def __init__(self, path: Path, *, keep_truncated: bool = False) -> None:
        """Open the files."""
        self.path = path
        self.bytes_read = 0
        files = _files(path) if path.is_dir() else [path]
        self._storages = [_Storage(file, keep_truncated) for file in files]
        self._storages.sort(key=lambda storage: storage.start_ns)
        self.is_ros1 = any(storage.is_ros1 for storage in self._storages)
        self.total_bytes = sum(storage.total_bytes for storage in self._storages)
        self.topics: Mapping[str, Topic] = count_topics(
            (name, topic.type, topic.messages) for storage in self._storages for name, topic in storage.topics.items()
        )

    @property
    def is_truncated(self) -> bool:
        """Whether a part is missing."""
        return any(storage.is_truncated for storage in self._storages)

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """Messages of some topics in the order of recording."""
        before = 0
        for storage in self._storages:
            bytes_per_ns = storage.total_bytes / max(storage.end_ns - storage.start_ns, 1)
            for message in storage.messages(topics):
                self.bytes_read = before + int((message[0] - storage.start_ns) * bytes_per_ns)
                yield message
            before += storage.total_bytes
        self.bytes_read = before


def _files(folder: Path) -> list[Path]:
    """Files of a bag; its metadata.yaml, which a killed recorder never writes, has no further information."""
    found = sorted({path for name in _NAMES for path in folder.glob(name)})
    if not found:
        raise InputError(folder, "expected the folder of a ROS 2 bag, got one without .db3 or .mcap files")
    return found


@final
class _Storage:
    """One file, opened for as long as this object lives: to reopen it, rosbags would count all its messages."""

    def __init__(self, path: Path, keep_truncated: bool) -> None:
        self.is_truncated = False
        self._path = path
        self._keep_truncated = keep_truncated
        with open_for_reading(path) as file:
            head = file.read(16)
            self.total_bytes = file.seek(0, 2)
        if head.startswith(ZSTD_MAGIC):
            path = self._unpacked()
            with path.open("rb") as file:
                head = file.read(16)
        is_mcap = head.startswith(_MCAP)
        if not is_mcap and not head.startswith(_SQLITE):
            raise InputError(self._path, f"expected an mcap or SQLite file, got one that begins with {head[:8]!r}")
        log = self._path.with_name(self._path.name + "-wal")
        if log.is_file() and log.stat().st_size:
            self._cut(f"{log.name} beside it holds messages that SQLite has not merged: the recording was not ended")
        self._reader: _Reader
        try:
            self._reader = _IndexedFile(path, is_mcap)
        except Exception as error:  # rosbags: also bare assertions and whatever its parts raise
            self._reader = _SalvagedMcap(path) if is_mcap else _SalvagedSqlite(path)
            if self._reader.problem:
                self._cut(f"the file is damaged or cut off ({self._reader.problem})")
            elif not is_mcap:
                self._cut(f"the file is damaged or no bag ({_describe_error(error)})")
        self.is_ros1 = self._reader.is_ros1
        self.start_ns = self._reader.start_ns
        self.end_ns = self._reader.end_ns
        self.topics = self._reader.topics

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        try:
            for time_ns, topic, data in self._reader.messages(topics):
                yield time_ns, topic, decompress(b"zstd", data) if data.startswith(ZSTD_MAGIC) else data
        except Exception as error:  # as in __init__
            self._cut(f"the file is damaged ({_describe_error(error)})")

    def _unpacked(self) -> Path:
        folder = TemporaryDirectory(prefix="gridslam")
        weakref.finalize(self, folder.cleanup)
        target = Path(folder.name) / "unpacked"
        problem = decompress_file(self._path, target)
        if problem:
            self._cut(problem)
        return target

    def _cut(self, problem: str) -> None:
        """Record that a part is missing, or raise if that is not accepted."""
        self.is_truncated = True
        if not self._keep_truncated:
            raise truncation_error(self._path, problem)


def _describe_error(error: Exception) -> str:
    known = isinstance(error, DamageError) or type(error).__name__ == "ReaderError"
    return str(error) if known else f"rosbags fails with {type(error).__name__}: {error}".removesuffix(": ")


@final
class _IndexedFile:
    """A file that is whole, by rosbags; raises whatever rosbags raises where it is not."""

    def __init__(self, path: Path, is_mcap: bool) -> None:
        from rosbags.rosbag2 import Reader

        self.is_ros1 = False
        self._reader: Any = Reader.STORAGE_PLUGINS[".mcap" if is_mcap else ".db3"](path)
        self._reader.open()
        weakref.finalize(self, self._reader.close)
        connections = self._reader.connections
        if not all(isinstance(name, str) for known in connections for name in (known.topic, known.msgtype)):
            raise DamageError("a topic without a name or a type")
        self.start_ns: int = self._reader.metadata.start_time
        self.end_ns: int = self._reader.metadata.end_time
        self.topics = count_topics((known.topic, known.msgtype, known.msgcount) for known in connections)

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        wanted = [
            known
            for known in self._reader.connections
            if known.topic in topics and known.msgtype == self.topics[known.topic].type
        ]
        for connection, time_ns, data in self._reader.messages(wanted) if wanted else ():
            if not (isinstance(time_ns, int) and isinstance(data, bytes)):
                raise DamageError("a message without a time or without data")
            yield time_ns, connection.topic, data


class _Channel(NamedTuple):
    topic: str
    type: str
    encoding: str


_Numbered: TypeAlias = tuple[int, int, bytes]
"""Time of recording, ns, number of the channel, and data."""


@final
class _SalvagedMcap:
    """An mcap file, read from its start without its summary; `problem` is what stopped the reading before the end."""

    def __init__(self, path: Path) -> None:
        """Read it through once."""
        self.problem = ""
        self._path = path
        self._schemas: dict[int, str] = {}
        self._channels: dict[int, _Channel] = {}
        counts: Counter[int] = Counter()
        self.start_ns = _LATEST_NS
        self.end_ns = 0
        for start_ns, messages in self._batches():
            times = [time_ns for time_ns, _, _ in messages]
            self.start_ns = min(self.start_ns, start_ns, *times)
            self.end_ns = max(self.end_ns, *times, 0)
            counts.update(number for _, number, _ in messages)
        self.is_ros1 = any(channel.encoding == "ros1" for channel in self._channels.values())
        self.topics = count_topics((topic, kind, counts[k]) for k, (topic, kind, _) in self._channels.items())

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
            file.seek(len(_MCAP))
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
        try:
            data = decompress(content[_CHUNK_HEAD.size : begin], content[begin + 8 :], size)
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
class _SalvagedSqlite:
    """An SQLite file, read row by row; `problem` is the first page that is missing or damaged."""

    def __init__(self, path: Path) -> None:
        """Read it through once."""
        self.is_ros1 = False
        self.problem = ""
        self.start_ns = _LATEST_NS
        self.end_ns = 0
        self._path = path
        types = {row[0]: (str(row[1]), str(row[2])) for row in self._rows(1, "SELECT id, name, type FROM topics")}
        self._topics = {number: name for number, (name, _) in types.items()}
        counts: Counter[int] = Counter()
        for number, time_ns in self._rows(2, "SELECT topic_id, timestamp FROM messages"):
            counts[number] += 1
            self.start_ns = min(self.start_ns, time_ns)
            self.end_ns = max(self.end_ns, time_ns)
        self.topics = count_topics((name, kind, counts[number]) for number, (name, kind) in types.items())

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


_Reader: TypeAlias = _IndexedFile | _SalvagedMcap | _SalvagedSqlite
