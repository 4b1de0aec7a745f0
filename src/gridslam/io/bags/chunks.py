"""Files of records, most of them in compressed chunks, as ROS 1 bags and mcap files are: read a chunk at a time.

The heads of all records are looked at once, and no other index is needed: behind a chunk stands one of its messages, so
that no chunk is unpacked that need not be. A chunk without it is unpacked. rosbags' readers take no file that is
damaged or that was not closed, and unpack whatever a file claims to hold.
"""

from __future__ import annotations

import bz2
import importlib
import struct
import sys
from bisect import bisect_left
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from enum import Enum, auto
from io import BytesIO
from operator import itemgetter
from pathlib import Path
from typing import IO, Any, NamedTuple, Protocol, TypeAlias, final

from lz4.frame import LZ4FrameDecompressor

from gridslam.errors import InputError
from gridslam.io.limits import UnpackingLimit, describe_bytes, max_memory_bytes, require_memory
from gridslam.io.log_statistics import Topic

Message = tuple[int, str, bytes]
"""Time of its recording in ns, topic, serialized bytes."""

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
"""First bytes of Zstandard, in which ROS 2 compresses the messages or the files of a bag."""

LATEST_NS = (1 << 63) - 1
"""Latest time of recording that 64 bits hold."""

_when = itemgetter(0)
_BLOCK_BYTES = 1 << 20
_MESSAGE_BYTES = 150  # that a message takes beside its data


@final
class DamageError(Exception):
    """A bag violates its format; reported to the user as an `InputError`."""


Numbered: TypeAlias = tuple[int, int, bytes]
"""Time of recording, ns, number of the channel, and data of a message."""


class Kind(Enum):
    """Kinds of records."""

    CHUNK = auto()
    INDEX = auto()
    MESSAGE = auto()
    DEFINITION = auto()
    OTHER = auto()


class Head(NamedTuple):
    """Kind of a record, where it stands, where its content begins and ends, and fields ahead of its content."""

    kind: Kind
    position: int
    begin: int
    end: int
    fields: Mapping[bytes, bytes]


class ChunkFormat(Protocol):
    """How records are written; all methods raise DamageError or struct.error where a record is malformed.

    Attributes
    ----------
    is_ros1 : bool
        Whether messages are serialized as in ROS 1; else as in ROS 2.
    channels : dict of int to (str, str)
        Topic and type by the number of the channel, as far as defined.
    """

    @property
    def is_ros1(self) -> bool:
        """Whether messages are serialized as in ROS 1."""
        ...

    @property
    def channels(self) -> dict[int, tuple[str, str]]:
        """Topics and types."""
        ...

    def heads(self, file: IO[bytes], position: int, size: int, *, inside: bool = False) -> Iterator[Head]:
        """Heads of the records from a position to the end of a file, or `inside` a chunk; the file is at the content.

        Raises DamageError where they end before; a chunk that is cut off is given ahead of that.
        """
        ...

    def define(self, head: Head, content: bytes) -> None:
        """Take in a definition."""
        ...

    def index(self, head: Head, content: bytes) -> tuple[int, list[int]]:
        """Number of a channel, and the times of its messages in the chunk before."""
        ...

    def message(self, head: Head, content: bytes) -> Numbered:
        """A message."""
        ...

    def unpack(self, head: Head, content: bytes, limit: UnpackingLimit) -> tuple[bytes, str]:
        """Decompress the records of a chunk; return them and their damage, empty where there is none."""
        ...


class Chunk(NamedTuple):
    """A part of a bag that is read at once: time of its first message, ns, its place and whose messages it holds."""

    start_ns: int
    position: int
    connections: frozenset[int]


def count_topics(found: Iterable[tuple[str, str, int]]) -> dict[str, Topic]:
    """Sum up names, types and numbers of messages; of a name that stands for several types the first one counts."""
    topics: dict[str, Topic] = {}
    for name, kind, messages in found:
        before = topics.get(name, Topic(kind, 0))
        if before.type == kind:
            topics[name] = Topic(kind, before.messages + messages)
    return topics


def merge_chunks(chunks: Iterable[tuple[int, Iterable[Message]]]) -> Iterator[Message]:
    """Merge chunks, given as start time and messages by ascending start time, into one stream ordered by time.

    Holds no more messages than overlap in time; those of one time stay in the order in which they came. Raises
    DamageError where they take more memory than readers are allowed.
    """
    waiting: list[Message] = []
    held = 0
    most = max_memory_bytes()
    for start_ns, messages in chunks:
        ready = bisect_left(waiting, start_ns, key=_when)
        held -= _size_of(waiting[:ready])
        yield from waiting[:ready]
        del waiting[:ready]
        before = len(waiting)
        waiting.extend(messages)
        held += _size_of(waiting[before:])
        if held > most:
            raise DamageError(f"chunks that overlap in time take more than the {describe_bytes(most)} of --max-memory")
        waiting.sort(key=_when)
    yield from waiting


def _size_of(messages: Iterable[Message]) -> int:
    """Estimate the memory of messages, bytes."""
    return sum(len(data) + _MESSAGE_BYTES for _, _, data in messages)


class BagFile:
    """A file of a bag; each kind has a method `messages`.

    Attributes
    ----------
    problem : str
        What is missing or damaged; empty where nothing is.
    is_ros1 : bool
        Whether its messages are those of ROS 1.
    topics : dict of str to Topic
        All there are.
    start_ns, end_ns : int
        Times of recording of the first and of the last message.
    """

    topics: dict[str, Topic]

    def __init__(self, path: Path) -> None:
        self.problem = ""
        self.is_ros1 = False
        self.start_ns = LATEST_NS
        self.end_ns = 0
        self._path = path
        self._size = path.stat().st_size

    @contextmanager
    def _raise_problem(self) -> Iterator[None]:
        """Raise a DamageError at the end of a reading that met a problem; the first one of the file is kept."""
        before = self.problem
        self.problem = ""
        yield
        problem = self.problem
        self.problem = before or problem
        if problem:
            raise DamageError(problem)


@final
class ChunkedFile(BagFile):
    """A file of records in chunks."""

    def __init__(self, path: Path, form: ChunkFormat) -> None:
        """Look at the heads of the records."""
        super().__init__(path)
        self._form = form
        self._chunks: list[Chunk] = []
        counts: Counter[int] = Counter()
        with path.open("rb") as file:
            places = self._find_chunks(file)
            limit = UnpackingLimit(self._size)
            for place, times in places.items():
                if not times:
                    for time_ns, number, _ in self._messages_in(file, place, limit):
                        _add_time(times, number, [time_ns])
                if times:
                    counts.update({number: count for number, (count, _, _) in times.items()})
                    start_ns = min(first_ns for _, first_ns, _ in times.values())
                    self._chunks.append(Chunk(start_ns, place, frozenset(times)))
                    self.start_ns = min(self.start_ns, start_ns)
                    self.end_ns = max(self.end_ns, *(last_ns for _, _, last_ns in times.values()))
            if counts.keys() - form.channels.keys():  # they are defined in chunks alone
                limit = UnpackingLimit(self._size)
                for chunk in self._chunks:
                    self._messages_in(file, chunk.position, limit)
        self._chunks.sort()
        self.is_ros1 = form.is_ros1
        self.topics = count_topics((topic, kind, counts[k]) for k, (topic, kind) in form.channels.items())

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """Yield messages of some topics, by the time of their recording.

        Raises DamageError at the end where a chunk is damaged, and at once where chunks take too much memory.
        """
        wanted = {
            number: topic
            for number, (topic, kind) in self._form.channels.items()
            if topic in topics and kind == self.topics[topic].type
        }
        limit = UnpackingLimit(self._size)
        with self._raise_problem(), self._path.open("rb") as file:
            yield from merge_chunks(
                (
                    chunk.start_ns,
                    [
                        (time_ns, wanted[number], data)
                        for time_ns, number, data in self._messages_in(file, chunk.position, limit)
                        if number in wanted
                    ],
                )
                for chunk in self._chunks
                if not chunk.connections.isdisjoint(wanted)
            )

    def _find_chunks(self, file: IO[bytes]) -> dict[int, _Times]:
        """Find definitions and chunks, with the times that indices state; a message that is in none counts as one."""
        found: dict[int, _Times] = {}
        times: _Times = {}
        try:
            for head in self._form.heads(file, 0, self._size):
                if head.kind is Kind.CHUNK:
                    times = found[head.position] = {}
                elif head.kind is Kind.INDEX:
                    _add_time(times, *self._form.index(head, self._content(file, head)))
                elif head.kind is Kind.MESSAGE:
                    time_ns, number, _ = self._form.message(head, self._content(file, head))
                    found[head.position] = {number: (1, time_ns, time_ns)}
                elif head.kind is Kind.DEFINITION:
                    self._form.define(head, self._content(file, head))
        except (DamageError, struct.error) as error:
            self.problem = str(error)
        return found

    def _messages_in(self, file: IO[bytes], place: int, limit: UnpackingLimit) -> list[Numbered]:
        """Return messages of a chunk, or of the record that is a message, as far as they can be read."""
        found: list[Numbered] = []
        form = self._form
        try:
            head = next(form.heads(file, place, self._size))
            content = self._content(file, head)
            if head.kind is Kind.MESSAGE:
                return [form.message(head, content)]
            data, problem = form.unpack(head, content, limit)
            records = BytesIO(data)
            for record in form.heads(records, 0, len(data), inside=True):
                if record.kind is Kind.MESSAGE:
                    found.append(form.message(record, records.read(record.end - record.begin)))
                elif record.kind is Kind.DEFINITION:
                    form.define(record, records.read(record.end - record.begin))
            if problem:
                raise DamageError(problem)
        except (DamageError, struct.error) as error:
            self.problem = self.problem or f"the chunk at byte {place} is damaged: {error}"
        return found

    def _content(self, file: IO[bytes], head: Head) -> bytes:
        size = min(head.end, self._size) - head.begin
        require_memory(self._path, f"the record at byte {head.position}", size)
        return file.read(size)


_Times: TypeAlias = dict[int, tuple[int, int, int]]
"""How many messages of each channel there are, and the times of the first and of the last one."""


def _add_time(times: _Times, number: int, stamps_ns: Sequence[int]) -> None:
    count, first_ns, last_ns = times.get(number, (0, LATEST_NS, 0))
    if stamps_ns:
        times[number] = count + len(stamps_ns), min(first_ns, *stamps_ns), max(last_ns, *stamps_ns)


def decompress(compression: bytes, data: bytes, limit: UnpackingLimit, size: int = -1) -> bytes:
    """Decompress a chunk or a message, by the name that bags give to the compression.

    Gives `size` bytes at most if that is given, and less where `data` is cut off. Raises DamageError where they are
    damaged, the compression is not known, or there are more bytes than `limit` leaves.
    """
    at_once = limit.at_once
    if size > at_once:
        raise DamageError(limit.problem)
    if compression in (b"none", b""):
        found = data
    else:
        zstd = _zstd()
        known = {b"bz2": bz2.BZ2Decompressor, b"lz4": LZ4FrameDecompressor, b"zstd": zstd.ZstdDecompressor}
        if compression not in known:
            raise DamageError(f"it is compressed by '{compression.decode(errors='replace')}', which is not known")
        try:
            found = known[compression]().decompress(data, at_once + 1 if size < 0 else size)
        except (OSError, ValueError, EOFError, RuntimeError, MemoryError, zstd.ZstdError) as error:
            raise DamageError(f"its data cannot be decompressed: {error}") from None
    if len(found) > at_once or not limit.take(len(found)):
        raise DamageError(limit.problem)
    return found


def decompress_file(packed: Path, target: Path) -> str:
    """Decompress a file (zstd) into another; returns why the latter is not whole, or an empty text.

    Raises InputError where it unpacks to more than is allowed, or than there is room for.
    """
    zstd = _zstd()
    limit = UnpackingLimit(packed.stat().st_size)
    with target.open("wb") as file:
        try:
            with zstd.open(packed, "rb") as stream:
                while block := stream.read1(_BLOCK_BYTES):
                    if not limit.take(len(block)):
                        raise InputError(packed, limit.problem)
                    file.write(block)
        except (zstd.ZstdError, EOFError, MemoryError) as error:
            return f"it cannot be decompressed to its end: {error}"
        except OSError as error:
            raise InputError(packed, f"cannot be unpacked to {target.parent}: {error.strerror}") from None
    return ""


def _zstd() -> Any:  # noqa: ANN401
    """Import the module of the standard library, or its backport for Python before 3.14, which rosbags brings."""
    return importlib.import_module("compression.zstd" if sys.version_info >= (3, 14) else "backports.zstd")
