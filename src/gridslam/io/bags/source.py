"""The interface of bags of every format, their compression, and their errors."""

from __future__ import annotations

import bz2
import importlib
import sys
from bisect import bisect_left
from collections.abc import Collection, Iterable, Iterator, Mapping
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple, Protocol, final

from lz4.frame import LZ4FrameDecompressor

from gridslam.errors import InputError
from gridslam.io.limits import UnpackingLimit, describe_bytes, max_memory_bytes
from gridslam.io.log_statistics import Topic

Message = tuple[int, str, bytes]
"""Time of its recording in ns, topic, serialized bytes."""

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
"""First bytes of Zstandard, in which ROS 2 compresses the messages or the files of a bag."""

_when = itemgetter(0)
_BLOCK_BYTES = 1 << 20
_MESSAGE_BYTES = 150  # that a message takes beside its data


@final
class DamageError(Exception):
    """A bag violates its format; reported to the user as an `InputError`."""


class BagSource(Protocol):
    """A bag whose messages can be read in the order of their recording, again and again.

    Attributes
    ----------
    path : Path
        File or folder.
    topics : mapping of str to Topic
        All there are.
    is_ros1 : bool
        Whether messages are serialized as in ROS 1; else as in ROS 2.
    total_bytes, bytes_read : int
        Size, and how much of it the latest reading has taken in.
    is_truncated : bool
        Whether a part is missing, at the end or behind a damage; known at the latest once all has been read.
    missing_files : tuple of str
        Files that belong to it by its own list, and are not there.
    """

    path: Path
    topics: Mapping[str, Topic]
    is_ros1: bool
    total_bytes: int
    bytes_read: int
    missing_files: tuple[str, ...]

    @property
    def is_truncated(self) -> bool:
        """Whether a part is missing."""
        ...

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """Messages of some topics in the order of recording; raises InputError where the bag cannot be read on."""
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


def truncation_error(path: Path, problem: str) -> InputError:
    """Return the error of a bag that is damaged or cut off, with the way to read it up to there."""
    one_line = "".join(letter if letter.isprintable() else "?" for letter in problem)  # bytes of the file among them
    return InputError(path, f"{one_line}; --keep-truncated reads what is there")


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
