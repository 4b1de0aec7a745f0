"""Reader of ROS 1 bags (format 2.0), a chunk at a time; their index may be wrong or missing.

rosbags keeps an index entry for each message and gives up where one of them is wrong. Here the index of the chunks is
all that is kept, the index of the messages is not looked at, and where the index of the chunks does not hold, the file
is walked through once to find them.

Source: wiki.ros.org/Bags/Format/2.0.
"""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import IO, NamedTuple, final

from gridslam.errors import InputError
from gridslam.io.bags.ros1_records import Op, Ros1Record, chunk_data, fields_of, messages_in, number_of, read_record
from gridslam.io.bags.source import Chunk, DamageError, Message, merge_chunks, raise_truncated
from gridslam.io.log_statistics import Topic
from gridslam.io.text import open_for_reading

__all__ = ["Ros1Bag"]

_MAGIC = b"#ROSBAG V2.0\n"
_COUNTS = struct.Struct("<II")


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
        self.bytes_read = 0
        self._keep_truncated = keep_truncated
        self._connections: dict[int, _Connection] = {}
        self._counts: Counter[int] = Counter()
        self._chunks: list[Chunk] = []
        with open_for_reading(path) as file:
            self.total_bytes = file.seek(0, 2)
            self._open(file)
        self._chunks.sort()
        self.topics: Mapping[str, Topic] = self._topics()

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """Messages of some topics in the order of recording."""
        numbers = {
            number: connection.topic
            for number, connection in self._connections.items()
            if connection.topic in topics and connection.type == self.topics[connection.topic].type
        }
        wanted = {number.to_bytes(4, "little"): topic for number, topic in numbers.items()}
        chunks = [chunk for chunk in self._chunks if not chunk.connections.isdisjoint(numbers)]
        self.bytes_read = 0
        with open_for_reading(self.path) as file:
            yield from merge_chunks((chunk.start_ns, self._wanted(file, chunk, wanted)) for chunk in chunks)
        self.bytes_read = self.total_bytes

    def _wanted(self, file: IO[bytes], chunk: Chunk, topics: dict[bytes, str]) -> list[Message]:
        found: list[Message] = []
        try:
            data, whole = self._chunk(file, read_record(file, chunk.position, Op.CHUNK))
            self.bytes_read = max(self.bytes_read, file.tell())
            for number, time_ns, begin, end in messages_in(data):
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
            raise raise_truncated(self.path, problem)

    def _open(self, file: IO[bytes]) -> None:
        file.seek(0)
        magic = file.read(len(_MAGIC))
        if magic != _MAGIC:
            raise InputError(self.path, f"expected a ROS 1 bag of version 2.0, got one that begins with {magic!r}")
        try:
            header = read_record(file, len(_MAGIC))
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
            record = read_record(file, position, Op.CONNECTION)
            self._connect(record, self._data(file, record))
            position = record.end
        for _ in range(chunks):
            record = read_record(file, position, Op.CHUNK_INFO)
            data = self._data(file, record)
            if record.u32(b"ver") != 1 or len(data) != 8 * record.u32(b"count"):
                raise DamageError("an index of chunks that is malformed")
            counts = dict(_COUNTS.iter_unpack(data))
            if not counts.keys() <= self._connections.keys():
                raise DamageError("an index of chunks that names an unknown connection")
            self._counts.update(counts)
            place = record.u64(b"chunk_pos")
            read_record(file, place, Op.CHUNK)
            self._chunks.append(Chunk(record.time_ns(b"start_time"), place, frozenset(counts)))
            position = record.end

    def _walk(self, file: IO[bytes]) -> str:
        """Find connections and chunks by reading the file from its start; returns what stopped it before the end."""
        position = len(_MAGIC)
        while position < self.total_bytes:
            try:
                record = read_record(file, position)
                if record.op == Op.CHUNK:
                    self._walk_chunk(file, record, position)
                elif record.op == Op.CONNECTION:
                    self._connect(record, self._data(file, record))
                elif record.op not in (Op.BAG_HEADER, Op.INDEX, Op.CHUNK_INFO):
                    raise DamageError(f"a record of unknown kind {record.op}")
                position = record.end
                if record.op == Op.INDEX:  # the length of these is wrong in some bags, their count is right
                    position = record.begin + 12 * record.u32(b"count")
            except DamageError as damage:
                return f"the file is damaged or cut off at byte {position} ({damage})"
        return "" if position == self.total_bytes else "the file is cut off at its end"

    def _walk_chunk(self, file: IO[bytes], record: Ros1Record, position: int) -> None:
        data, whole = self._chunk(file, record)
        times: list[int] = []
        numbers: Counter[int] = Counter()
        try:
            for number, time_ns, _, _ in messages_in(data, self._connect):
                times.append(time_ns)
                numbers[number_of(number)] += 1
        finally:
            if times:
                self._chunks.append(Chunk(min(times), position, frozenset(numbers)))
                self._counts.update(numbers)
        if not whole:
            raise DamageError("the file ends within a chunk")

    def _chunk(self, file: IO[bytes], record: Ros1Record) -> tuple[bytes, bool]:
        """Decompressed data of a chunk, and whether they are all there."""
        raw, size = self._data(file, record, cut=True), record.u32(b"size")
        data = chunk_data(record.field(b"compression"), raw, size)
        return data, len(raw) == record.end - record.begin and len(data) == size

    def _data(self, file: IO[bytes], record: Ros1Record, *, cut: bool = False) -> bytes:
        file.seek(record.begin)
        data = file.read(min(record.end, self.total_bytes) - record.begin)
        if len(data) != record.end - record.begin and not cut:
            raise DamageError("a record is cut off")
        return data

    def _connect(self, record: Ros1Record, data: bytes) -> None:
        """Add a connection."""
        described = Ros1Record(fields_of(data), 0, 0)
        topic = "/".join(part for part in record.text(b"topic").split("/") if part)
        self._connections[record.u32(b"conn")] = _Connection(f"/{topic}", described.text(b"type"))

    def _topics(self) -> dict[str, Topic]:
        """Topics by name; of a name that stands for several types the first one."""
        found: dict[str, Topic] = {}
        for number, (name, type_) in sorted(self._connections.items()):
            before = found.get(name, Topic(type_, 0))
            if before.type == type_:
                found[name] = Topic(type_, before.messages + self._counts[number])
        return found
