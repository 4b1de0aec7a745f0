"""Reader of ROS 2 bags through rosbags: a folder, or a single file of it (SQLite or mcap), also compressed by zstd."""

from __future__ import annotations

import weakref
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, final

from gridslam.errors import InputError
from gridslam.io.bags import zstd
from gridslam.io.bags.salvage import SalvagedMcap, SalvagedSqlite, SalvagedStorage
from gridslam.io.bags.source import DamageError, Message, raise_truncated
from gridslam.io.log_statistics import Topic
from gridslam.io.text import open_for_reading

if TYPE_CHECKING:
    from rosbags.interfaces import Connection

__all__ = ["Ros2Bag"]

_MCAP, _SQLITE = b"\x89MCAP0\r\n", b"SQLite format 3\0"
_NAMES = ("*.mcap", "*.db3", "*.mcap.zst*", "*.db3.zst*")


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
        self._bytes_before, self._time_ns = 0, 0
        self._current: _Storage | None = None
        files = _files(path) if path.is_dir() else [path]
        self._storages = [_Storage(file, keep_truncated) for file in files]
        self._storages.sort(key=lambda storage: storage.start_ns)
        self.is_ros1 = any(storage.is_ros1 for storage in self._storages)
        self.total_bytes = sum(storage.total_bytes for storage in self._storages)
        self.topics: Mapping[str, Topic] = _joined(self._storages)

    @property
    def bytes_read(self) -> int:
        """How much has been read: within a file estimated from the time of its last message."""
        within = 0 if self._current is None else self._current.bytes_at(self._time_ns)
        return self._bytes_before + within

    @property
    def is_truncated(self) -> bool:
        """Whether a part is missing."""
        return any(storage.is_truncated for storage in self._storages)

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """Messages of some topics in the order of recording."""
        self._bytes_before, self._current = 0, None
        for storage in self._storages:
            self._time_ns, self._current = storage.start_ns, storage
            for message in storage.messages(topics):
                self._time_ns = message[0]
                yield message
            self._bytes_before += storage.total_bytes
            self._current = None


def _files(folder: Path) -> list[Path]:
    """Files of a bag; its metadata.yaml, which a killed recorder never writes, has no further information."""
    found = sorted({path for name in _NAMES for path in folder.glob(name)})
    if not found:
        raise InputError(folder, "expected the folder of a ROS 2 bag, got one without .db3 or .mcap files")
    return found


def _joined(storages: list[_Storage]) -> dict[str, Topic]:
    found: dict[str, Topic] = {}
    for storage in storages:
        for name, topic in storage.topics.items():
            before = found.get(name, Topic(topic.type, 0))
            found[name] = Topic(before.type, before.messages + topic.messages)
    return found


@final
class _Storage:
    """One file, opened for as long as this object lives: to reopen it, rosbags would count all its messages."""

    def __init__(self, path: Path, keep_truncated: bool) -> None:
        self.is_truncated = False
        self._path = path
        self._keep_truncated = keep_truncated
        self._salvaged: SalvagedStorage | None = None
        self._connections: list[Connection] = []
        with open_for_reading(path) as file:
            head = file.read(16)
            self.total_bytes = file.seek(0, 2)
        if zstd.is_compressed(head):
            path = self._unpacked()
            with path.open("rb") as file:
                head = file.read(16)
        if not head.startswith((_MCAP, _SQLITE)):
            raise InputError(self._path, f"expected an mcap or SQLite file, got one that begins with {head[:8]!r}")
        self._refuse_unmerged()
        try:
            self._open(path, ".mcap" if head.startswith(_MCAP) else ".db3")
        except Exception as error:  # rosbags: also bare assertions and whatever its parts raise
            self._salvage(path, head.startswith(_MCAP), error)

    def _open(self, path: Path, suffix: str) -> None:
        from rosbags.rosbag2 import Reader

        reader: Any = Reader.STORAGE_PLUGINS[suffix](path)
        reader.open()
        weakref.finalize(self, reader.close)
        self.is_ros1 = False
        self._reader = reader
        self._connections = list(reader.connections)
        if not all(isinstance(name, str) for known in self._connections for name in (known.topic, known.msgtype)):
            raise DamageError("a topic without a name or a type")
        self.start_ns, self.end_ns = reader.metadata.start_time, reader.metadata.end_time
        self.topics: dict[str, Topic] = {}
        for connection in self._connections:
            before = self.topics.get(connection.topic, Topic(connection.msgtype, 0))
            self.topics[connection.topic] = Topic(before.type, before.messages + connection.msgcount)

    def _salvage(self, path: Path, is_mcap: bool, error: Exception) -> None:
        found: SalvagedStorage = SalvagedMcap(path) if is_mcap else SalvagedSqlite(path)
        if found.problem:
            self._cut(f"the file is damaged or cut off ({found.problem})")
        elif not is_mcap:
            self._cut(f"the file is damaged or no bag ({_describe_error(error)})")
        self._salvaged, self.is_ros1 = found, found.is_ros1
        self.topics, self.start_ns, self.end_ns = found.topics, found.start_ns, found.end_ns

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        if self._salvaged is not None:
            yield from self._salvaged.messages(topics)
            return
        wanted = [
            connection
            for connection in self._connections
            if connection.topic in topics and connection.msgtype == self.topics[connection.topic].type
        ]
        if not wanted:
            return
        try:
            for connection, time_ns, data in self._reader.messages(wanted):
                if not (isinstance(time_ns, int) and isinstance(data, bytes)):
                    raise DamageError("a message without a time or without data")
                yield time_ns, connection.topic, zstd.decompress(data) if zstd.is_compressed(data) else data
        except Exception as error:  # as in __init__
            self._cut(f"the file is damaged ({_describe_error(error)})")

    def bytes_at(self, time_ns: int) -> int:
        """How much of the file is read once the message of this time is."""
        share = (time_ns - self.start_ns) / max(self.end_ns - self.start_ns, 1)
        return int(self.total_bytes * min(max(share, 0.0), 1.0))

    def _unpacked(self) -> Path:
        folder = TemporaryDirectory(prefix="gridslam")
        weakref.finalize(self, folder.cleanup)
        target = Path(folder.name) / "unpacked"
        problem = zstd.unpack(self._path, target)
        if problem:
            self._cut(problem)
        return target

    def _refuse_unmerged(self) -> None:
        log = self._path.with_name(self._path.name + "-wal")
        if log.is_file() and log.stat().st_size:
            self._cut(f"{log.name} beside it holds messages that SQLite has not merged: the recording was not ended")

    def _cut(self, problem: str) -> None:
        """Record that a part is missing, or raise if that is not accepted."""
        self.is_truncated = True
        if not self._keep_truncated:
            raise raise_truncated(self._path, problem)


def _describe_error(error: Exception) -> str:
    known = isinstance(error, DamageError) or type(error).__name__ == "ReaderError"
    return str(error) if known else f"rosbags fails with {type(error).__name__}: {error}".removesuffix(": ")
