"""Bags: a file of ROS 1, or of ROS 2 a folder or a single file of it (SQLite or mcap), also compressed by zstd."""

from __future__ import annotations

import weakref
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import final

from gridslam.errors import InputError
from gridslam.io.bags.chunks import (
    ZSTD_MAGIC,
    ChunkedFile,
    DamageError,
    Message,
    count_topics,
    decompress,
    decompress_file,
)
from gridslam.io.bags.encoder import MessageEncoder
from gridslam.io.bags.mcap import MCAP_MAGIC, McapFormat
from gridslam.io.bags.ros1 import ROS1_MAGIC, Ros1Format
from gridslam.io.bags.sqlite import SQLITE_MAGIC, SqliteFile
from gridslam.io.limits import UnpackingLimit
from gridslam.io.log_statistics import Topic
from gridslam.io.text import open_for_reading, read_text
from gridslam.io.yaml import YamlError, parse_yaml

_NAMES = ("*.mcap", "*.db3", "*.mcap.zst*", "*.db3.zst*")


@final
class BagSource:
    """A bag whose messages can be read in the order of their recording, again and again.

    Its files come one after another, by the time of their first message.

    Parameters
    ----------
    path : Path
        A file, or the folder of a ROS 2 bag, whether there is a metadata.yaml in it or not.
    keep_truncated : bool
        Whether a file that was not closed, or ends early, or is damaged is read as far as it goes.

    Attributes
    ----------
    topics : mapping of str to Topic
        All there are.
    encoder : MessageEncoder
        Of its messages, by ROS 1 or ROS 2.
    total_bytes, bytes_read : int
        Size, and how much of it the latest reading has taken in.
    missing_files : tuple of str
        Files that belong to it by its own list, and are not there.

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
        self.missing_files = _missing_files(path, files) if path.is_dir() else ()
        self._storages = [_Storage(file, keep_truncated) for file in files]
        self._storages.sort(key=lambda storage: storage.reader.start_ns)
        self.encoder = MessageEncoder(is_ros1=any(storage.reader.is_ros1 for storage in self._storages))
        self.total_bytes = sum(storage.total_bytes for storage in self._storages)
        self.topics: Mapping[str, Topic] = count_topics(
            (name, topic.type, topic.messages)
            for storage in self._storages
            for name, topic in storage.reader.topics.items()
        )

    @property
    def is_truncated(self) -> bool:
        """Whether a part is missing, at the end or behind a damage; known at the latest once all has been read."""
        return any(storage.is_truncated for storage in self._storages)

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """Yield messages of some topics in the order of recording; raises InputError where it cannot be read on."""
        before = 0
        for storage in self._storages:
            start_ns = storage.reader.start_ns
            bytes_per_ns = storage.total_bytes / max(storage.reader.end_ns - start_ns, 1)
            for message in storage.messages(topics):
                self.bytes_read = before + int((message[0] - start_ns) * bytes_per_ns)
                yield message
            before += storage.total_bytes
        self.bytes_read = before


def _missing_files(folder: Path, files: Sequence[Path]) -> tuple[str, ...]:
    """Files that the metadata.yaml of a bag lists and that are not there.

    As many files beside it that it does not list are taken for the same ones by other names.
    """
    try:
        tree = parse_yaml(read_text(folder / "metadata.yaml"))
        listed = tree["rosbag2_bagfile_information"]["relative_file_paths"]
        names = [Path(name).name for name in listed]
    except (InputError, YamlError, TypeError, KeyError, ValueError):
        return ()
    present = {file.name for file in files}
    missing = [name for name in names if name not in present]
    return tuple(missing) if len(present.difference(names)) < len(missing) else ()


def _files(folder: Path) -> list[Path]:
    """Return files of a bag, by their suffix: a recorder that is killed never writes its metadata.yaml."""
    found = sorted({path for name in _NAMES for path in folder.glob(name)})
    if not found:
        raise InputError(folder, "expected the folder of a ROS 2 bag, got one without .db3 or .mcap files")
    return found


@final
class _Storage:
    """One file, unpacked for as long as this object lives."""

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
        log = self._path.with_name(self._path.name + "-wal")
        if log.is_file() and log.stat().st_size:
            self._cut(f"{log.name} beside it holds messages that SQLite has not merged: the recording was not ended")
        self.reader = self._open(path, head)
        if self.reader.problem:
            self._cut(f"the file is damaged or cut off ({self.reader.problem})")

    def _open(self, path: Path, head: bytes) -> ChunkedFile | SqliteFile:
        if head.startswith(ROS1_MAGIC):
            return ChunkedFile(path, Ros1Format())
        if head.startswith(MCAP_MAGIC):
            return ChunkedFile(path, McapFormat())
        if head.startswith(SQLITE_MAGIC):
            return SqliteFile(path)
        raise InputError(self._path, f"expected a ROS 1 bag, an mcap or SQLite file, got one that begins with {head!r}")

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        limit = UnpackingLimit(self.total_bytes)
        try:
            for time_ns, topic, data in self.reader.messages(topics):
                yield time_ns, topic, decompress(b"zstd", data, limit) if data.startswith(ZSTD_MAGIC) else data
        except DamageError as damage:
            self._cut(f"the file is damaged ({damage})")

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
            one_line = "".join(letter if letter.isprintable() else "?" for letter in problem)  # bytes of the file
            raise InputError(self._path, f"{one_line}; --keep-truncated reads what is there")
