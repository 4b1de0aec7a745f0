"""SQLite files that others have made, opened so that they compute nothing: tables are read, and nothing else.

A view, a trigger, a virtual table or a generated column is a program that whoever reads the table runs, and that need
not end.

Source: sqlite.org, fileformat2.html (of the statements in the schema SQLite itself writes the first words).
"""

from __future__ import annotations

import os
import sqlite3
import time
from collections.abc import Iterable
from pathlib import Path
from urllib.parse import quote

AS_IT_LIES = "mode=ro&immutable=1"
"""How a file is opened beside which nothing may appear."""

_SCHEMA_S = 5.0  # of CPU, for what takes a millisecond
_STEPS = 1000  # of SQLite's virtual machine, between two checks
_STEPS_PER_BYTE = 100
_LEAST_STEPS = 100_000_000
_STATEMENTS = "CREATE TABLE ", "CREATE INDEX ", "CREATE UNIQUE INDEX "


def open_database(path: Path, tables: Iterable[str], mode: str = AS_IT_LIES) -> sqlite3.Connection:
    """Open a file that may be damaged or hostile, for reading some of its tables.

    All queries together take no more steps than a file of this size has rows for, however its pages refer to each
    other; then they are interrupted by sqlite3.OperationalError. A step, too, is bounded: none makes a value that is
    not in the file.

    Parameters
    ----------
    path : Path
        The file; its name may hold any character.
    tables : iterable of str
        Names of the tables that will be read.
    mode : str
        Parameters of SQLite's URI.

    Raises
    ------
    sqlite3.Error
        The file is no database, or holds more than tables.
    """
    connection = sqlite3.connect(f"file:{quote(os.fsencode(path.absolute()))}?{mode}", uri=True)
    try:
        end_s = time.thread_time() + _SCHEMA_S
        connection.set_progress_handler(lambda: time.thread_time() > end_s, _STEPS)
        connection.execute("PRAGMA writable_schema=ON")  # else a file that is cut off is refused as a whole
        require_tables(connection, tables)
        checks = iter(range(max(_LEAST_STEPS, _STEPS_PER_BYTE * path.stat().st_size) // _STEPS))
        connection.set_progress_handler(lambda: next(checks, None) is None, _STEPS)
    except BaseException:
        connection.close()
        raise
    return connection


def require_tables(connection: sqlite3.Connection, tables: Iterable[str]) -> None:
    """Raise sqlite3.DatabaseError where a schema holds more than tables and indices, or one of `tables` computes.

    What SQLite makes of a row of the schema follows from its statement alone: its type and its name may state something
    else, and names are the same in capitals.
    """
    for (statement,) in connection.execute("SELECT sql FROM sqlite_master"):
        if statement is not None and not str(statement).startswith(_STATEMENTS):
            raise sqlite3.DatabaseError(f"expected tables and their indices, got {str(statement)[:60]!r}")
    for name in tables:
        if any(column[6] for column in connection.execute(f"PRAGMA table_xinfo({name})")):
            raise sqlite3.DatabaseError(f"expected a table {name}, got one with computed columns")
