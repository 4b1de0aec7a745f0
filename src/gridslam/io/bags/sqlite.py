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
from urllib.parse import quote

from gridslam.io.bags.source import DamageError, Message, count_topics

__all__ = ["SQLITE_MAGIC", "SqliteFile"]

SQLITE_MAGIC = b"SQLite format 3\0"
"""First bytes of a file."""

_LATEST_NS = (1 << 63) - 1
_STEPS = 1_000_000  # of SQLite's virtual machine, between two checks
_STEPS_PER_BYTE = 100
_ORDERED = (
    "SELECT messages.timestamp, topics.id, messages.data FROM messages JOIN topics ON messages.topic_id=topics.id "
    "WHERE topics.id IN ({}) ORDER BY timestamp"
)
_AS_THEY_LIE = "SELECT timestamp, topic_id, data FROM messages"  # all: a damaged row must not look like another's


@final
class SqliteFile:
    """An SQLite file of a bag.

    Messages come by the time of their recording; where a page is missing or damaged, in the order of their rows as far
    as those go. A file computes nothing: views, virtual tables and generated columns in the place of the tables of a
    bag are refused, and a query takes no more steps than the file has bytes for.

    Attributes
    ----------
    problem : str
        What is missing or damaged; empty where nothing is.
    """

    def __init__(self, path: Path) -> None:
        """Count the messages."""
        self.is_ros1 = False
        self.problem = ""
        self.start_ns = _LATEST_NS
        self.end_ns = 0
        self._path = path
        self._checks = 100 + path.stat().st_size * _STEPS_PER_BYTE // _STEPS
        types = {row[0]: (row[1], row[2]) for row in self._rows(1, "SELECT id, name, type FROM topics")}
        types = {number: (name, kind) for number, (name, kind) in types.items() if isinstance(name, str)}
        self._topics = {number: name for number, (name, _) in types.items()}
        self._kinds = {number: str(kind) for number, (_, kind) in types.items()}
        counts: Counter[int] = Counter()
        for number, time_ns in self._rows(2, "SELECT topic_id, timestamp FROM messages"):
            counts[number] += 1
            self.start_ns = min(self.start_ns, time_ns)
            self.end_ns = max(self.end_ns, time_ns)
        self.topics = count_topics((name, self._kinds[number], counts[number]) for number, name in self._topics.items())

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """Messages of some topics; raises DamageError at the first one that is damaged, after those before it."""
        before = self.problem
        self.problem = ""
        wanted = {
            number: name
            for number, name in self._topics.items()
            if name in topics and self._kinds[number] == self.topics[name].type
        }
        query = _AS_THEY_LIE if before else _ORDERED.format(",".join(map(str, wanted)))
        for time_ns, number, data in self._rows(2, query):
            if number not in wanted:
                continue
            if not isinstance(data, bytes):
                self.problem = "a message without data"
                break
            yield time_ns, wanted[number], data
        problem = self.problem
        self.problem = before or problem
        if problem:
            raise DamageError(problem)

    def _rows(self, numbers: int, query: str) -> Iterator[Any]:
        """Rows whose first columns are `numbers` whole numbers, as they are where nothing is damaged."""
        uri = f"file:{quote(str(self._path.absolute()))}?mode=ro&immutable=1"
        left = self._checks

        def is_over() -> bool:
            nonlocal left
            left -= 1
            return left < 0

        try:
            with closing(sqlite3.connect(uri, uri=True)) as connection:
                connection.execute("PRAGMA writable_schema=ON")  # else a file that is cut off is refused as a whole
                connection.set_progress_handler(is_over, _STEPS)
                _require_plain(connection)
                for row in connection.execute(query):
                    if not all(isinstance(value, int) for value in row[:numbers]):
                        raise DamageError("a row is damaged")
                    yield row
        except (DamageError, sqlite3.Error, UnicodeError, MemoryError) as error:  # Unicode: quotes damaged text
            problem = "its tables have more rows than the file has room for" if left < 0 else str(error)
            self.problem = self.problem or problem or type(error).__name__


def _require_plain(connection: sqlite3.Connection) -> None:
    """Refuse tables whose content is computed: a query of them may never end."""
    for name in ("topics", "messages"):
        for kind, sql in connection.execute("SELECT type, sql FROM sqlite_master WHERE name = ?", (name,)):
            if kind != "table" or " ".join(str(sql).upper().split()).startswith("CREATE VIRTUAL"):
                raise DamageError(
                    f"expected a table named {name}, got a {'virtual table' if kind == 'table' else kind}"
                )
        if any(column[6] for column in connection.execute(f"PRAGMA table_xinfo({name})")):
            raise DamageError(f"expected a table named {name}, got one with computed columns")
