"""SQLite files of ROS 2 bags, read where they lie, and row by row where they are damaged.

Source: sqlite.org (a table's rows lie in the order of their ids, which is that of the recording).
"""

from __future__ import annotations

import sqlite3
from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any, final

from gridslam.io.bags.chunks import BagFile, DamageError, Message, count_topics
from gridslam.io.database import open_database
from gridslam.io.limits import require_memory

SQLITE_MAGIC = b"SQLite format 3\0"
"""First bytes of a file."""

_TABLES = "topics", "messages"
_COUNTED = (  # of the data only the length: it is not read
    "SELECT topic_id, timestamp, CASE typeof(data) WHEN 'blob' THEN length(data) END FROM messages"
)
_ORDERED = "SELECT timestamp, topic_id, data FROM messages WHERE topic_id IN ({}) ORDER BY timestamp, rowid"
_AS_THEY_LIE = "SELECT timestamp, topic_id, data FROM messages"  # all: a damaged row must not look like another's
_TOO_MANY = "its tables have more rows than the file has room for"


@final
class SqliteFile(BagFile):
    """An SQLite file of a bag.

    Messages come by the time of their recording; where a page is missing or damaged, in the order of their rows as far
    as those go. A file that computes is refused (see `open_database`), and so are rows that together are larger than
    the file, however its pages refer to each other.
    """

    def __init__(self, path: Path) -> None:
        """Count the messages."""
        super().__init__(path)
        rows = self._rows(1, "SELECT id, name, type FROM topics")
        self._channels = {number: (name, str(kind)) for number, name, kind in rows if isinstance(name, str)}
        counts: Counter[int] = Counter()
        left = self._size
        for number, time_ns, size in self._rows(3, _COUNTED):
            require_memory(path, "a message", size)
            left -= size
            if left < 0:
                self.problem = _TOO_MANY
                break
            counts[number] += 1
            self.start_ns = min(self.start_ns, time_ns)
            self.end_ns = max(self.end_ns, time_ns)
        self.topics = count_topics((name, kind, counts[number]) for number, (name, kind) in self._channels.items())

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """Yield messages of some topics; raises DamageError at the first one that is damaged, after those before it."""
        wanted = {
            number: name
            for number, (name, kind) in self._channels.items()
            if name in topics and kind == self.topics[name].type
        }
        query = _AS_THEY_LIE if self.problem else _ORDERED.format(",".join(map(str, wanted)))
        with self._raise_problem():
            for time_ns, number, data in self._rows(2, query):
                if number not in wanted:
                    continue
                if not isinstance(data, bytes):
                    self.problem = "a message without data"
                    break
                yield time_ns, wanted[number], data

    def _rows(self, numbers: int, query: str) -> Iterator[Any]:
        """Yield rows whose first columns are `numbers` whole numbers, as they are where nothing is damaged."""
        left = self._size
        try:
            with closing(open_database(self._path, _TABLES)) as connection:
                for row in connection.execute(query):
                    if not all(isinstance(value, int) for value in row[:numbers]):
                        raise DamageError("a row is damaged")
                    left -= sum(len(value) for value in row[numbers:] if isinstance(value, str | bytes))
                    if left < 0:
                        raise DamageError(_TOO_MANY)
                    yield row
        except (DamageError, sqlite3.Error, UnicodeError, MemoryError) as error:  # Unicode: quotes damaged text
            problem = _TOO_MANY if str(error) == "interrupted" else str(error)
            self.problem = self.problem or problem or type(error).__name__
