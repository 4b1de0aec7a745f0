"""What every kind of bag offers to the reader of logs, and what goes wrong with bags."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Collection, Iterable, Iterator, Mapping
from operator import itemgetter
from pathlib import Path
from typing import NamedTuple, Protocol, final

from gridslam.errors import InputError
from gridslam.io.log_statistics import Topic

__all__ = ["BagSource", "Chunk", "DamageError", "Message", "merge_chunks", "raise_truncated"]

Message = tuple[int, str, bytes]
"""Time of its recording in ns, topic, serialized bytes."""

_when = itemgetter(0)


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
    """

    path: Path
    topics: Mapping[str, Topic]
    is_ros1: bool
    total_bytes: int

    @property
    def bytes_read(self) -> int:
        """How much of the bag the latest reading has taken in."""

    @property
    def is_truncated(self) -> bool:
        """Whether a part is missing."""

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """Messages of some topics in the order of recording; raises InputError where the bag cannot be read on."""


class Chunk(NamedTuple):
    """A part of a bag that is read at once: time of its first message, ns, its place and whose messages it holds."""

    start_ns: int
    position: int
    connections: frozenset[int]


def merge_chunks(chunks: Iterable[tuple[int, Iterable[Message]]]) -> Iterator[Message]:
    """Merge chunks, given as start time and messages by ascending start time, into one stream ordered by time.

    Holds no more messages than overlap in time; those of one time stay in the order in which they came.
    """
    waiting: list[Message] = []
    for start_ns, messages in chunks:
        ready = bisect_left(waiting, start_ns, key=_when)
        yield from waiting[:ready]
        del waiting[:ready]
        waiting.extend(messages)
        waiting.sort(key=_when)
    yield from waiting


def raise_truncated(path: Path, problem: str) -> InputError:
    """Raise that a bag is damaged or cut off, and how to read it up to there."""
    one_line = "".join(letter if letter.isprintable() else "?" for letter in problem)  # bytes of the file among them
    return InputError(path, f"{one_line}; --keep-truncated reads what is there")
