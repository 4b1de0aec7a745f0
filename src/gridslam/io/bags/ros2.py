"""Reader of ROS 2 bags: a folder, or a single file of it (SQLite or mcap), also compressed by zstd.

Files are read by `McapFile` and `SqliteFile`, whole or not: rosbags' readers take no file that is damaged or whose name
has a %, # or ? in it, and unpack whatever a file claims to hold.
"""

from __future__ import annotations

import re
import weakref
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import final

from gridslam.errors import InputError
from gridslam.io.bags.mcap import MCAP_MAGIC, McapFile
from gridslam.io.bags.source import (
    ZSTD_MAGIC,
    DamageError,
    Message,
    count_topics,
    decompress,
    decompress_file,
    truncation_error,
)
from gridslam.io.bags.sqlite import SQLITE_MAGIC, SqliteFile
from gridslam.io.limits import UnpackingLimit
from gridslam.io.log_statistics import Topic
from gridslam.io.text import open_for_reading, read_text
from gridslam.io.yaml import YamlError, parse_yaml

_PART = re.compile(r"(.*_)(\d{1,4})(\..*)")
_MOST_PARTS = 1000
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
        self.bytes_read = 0
        files = _files(path) if path.is_dir() else [path]
        self.missing_files = _missing_files(path, files) if path.is_dir() else ()
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
        """Yield messages of some topics in the order of recording."""
        before = 0
        for storage in self._storages:
            bytes_per_ns = storage.total_bytes / max(storage.end_ns - storage.start_ns, 1)
            for message in storage.messages(topics):
                self.bytes_read = before + int((message[0] - storage.start_ns) * bytes_per_ns)
                yield message
            before += storage.total_bytes
        self.bytes_read = before


def _missing_files(folder: Path, files: Sequence[Path]) -> tuple[str, ...]:
    """Files that the metadata.yaml of a bag lists and that are not there.

    As many files beside it that it does not list are taken for the same ones by other names. Without it, or where it is
    damaged, the numbers that the recorder gives to the parts of a split bag show which are missing between others.
    """
    try:
        tree = parse_yaml(read_text(folder / "metadata.yaml"))
        listed = tree["rosbag2_bagfile_information"]["relative_file_paths"]
        names = [Path(name).name for name in listed]
    except (InputError, YamlError, TypeError, KeyError, ValueError):
        return _left_out([file.name for file in files])
    present = {file.name for file in files}
    missing = [name for name in names if name not in present]
    return tuple(missing) if len(present.difference(names)) < len(missing) else ()


def _left_out(names: Sequence[str]) -> tuple[str, ...]:
    """Names of files whose numbers are missing, of parts NAME_0, NAME_1, ... of one bag; none for other names."""
    parts = [_PART.fullmatch(name) for name in names]
    numbers = {int(part[2]) for part in parts if part}
    if None in parts or len({(part[1], part[3]) for part in parts if part}) != 1 or max(numbers) > _MOST_PARTS:
        return ()
    first = next(part for part in parts if part)
    return tuple(f"{first[1]}{k}{first[3]}" for k in range(min(numbers), max(numbers)) if k not in numbers)


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
        is_mcap = head.startswith(MCAP_MAGIC)
        if not is_mcap and not head.startswith(SQLITE_MAGIC):
            raise InputError(self._path, f"expected an mcap or SQLite file, got one that begins with {head[:8]!r}")
        log = self._path.with_name(self._path.name + "-wal")
        if log.is_file() and log.stat().st_size:
            self._cut(f"{log.name} beside it holds messages that SQLite has not merged: the recording was not ended")
        self._reader = McapFile(path) if is_mcap else SqliteFile(path)
        if self._reader.problem:
            self._cut(f"the file is damaged or cut off ({self._reader.problem})")
        self.is_ros1 = self._reader.is_ros1
        self.start_ns = self._reader.start_ns
        self.end_ns = self._reader.end_ns
        self.topics = self._reader.topics

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        limit = UnpackingLimit(self.total_bytes)
        try:
            for time_ns, topic, data in self._reader.messages(topics):
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
            raise truncation_error(self._path, problem)
