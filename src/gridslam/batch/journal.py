"""The journal of a batch, OUT/runs.sqlite: a row for each job that has ended."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, final

from gridslam.errors import InputError, OutputError
from gridslam.io.database import require_tables

JOURNAL = "runs.sqlite"

COLUMNS = {
    "key": "TEXT NOT NULL",
    "log": "TEXT NOT NULL",
    "command": "TEXT NOT NULL",
    "folder": "TEXT PRIMARY KEY",
    "status": "TEXT NOT NULL",
    "error": "TEXT",
    "message": "TEXT",
    "output_tail": "TEXT",
    "exit_status": "INTEGER",
    "wall_s": "REAL",
    "cpu_s": "REAL",
    "peak_memory_bytes": "INTEGER",
    "started": "TEXT",
    "document": "TEXT",
}
"""Columns of the table ``runs``: ``status`` is "done" or "failed", ``document`` JSON text (see docs/outputs.md)."""


@final
class Journal:
    """The file runs.sqlite in the folder of a batch; a context manager.

    SQLite in WAL mode: it can be read while it is written, and a process that is killed leaves it consistent.

    Parameters
    ----------
    folder : Path
        OUT; created if missing.

    Raises
    ------
    InputError
        There is a file of this name that is no journal.
    OutputError
        It cannot be written: the disk is full, for instance. All methods that write raise it.
    """

    def __init__(self, folder: Path) -> None:
        """Open the journal, or create it."""
        self.path = folder / JOURNAL
        columns = ", ".join(f"{name} {kind}" for name, kind in COLUMNS.items())
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(f"{folder}: cannot be written: {error.strerror}") from None
        with self._translate_errors():
            self._database = sqlite3.connect(self.path, timeout=30, isolation_level=None)
            try:
                require_tables(self._database, ["runs"])
                self._database.execute("PRAGMA journal_mode=WAL")
                self._database.execute("PRAGMA synchronous=NORMAL")
                self._database.execute(f"CREATE TABLE IF NOT EXISTS runs ({columns})")
                self._require_columns()
            except BaseException:
                self._database.close()
                raise

    def __enter__(self) -> Journal:
        """Return the journal itself."""
        return self

    def __exit__(self, *error: object) -> None:
        """Close the file."""
        with self._translate_errors():
            self._database.close()

    def find(self, folder: str) -> dict[str, Any] | None:
        """Return the row of a folder, if there is one."""
        with self._translate_errors():
            found = self._database.execute(
                f"SELECT {', '.join(COLUMNS)} FROM runs WHERE folder = ?", (_to_text(folder),)
            )
            values = found.fetchone()
        if values is None:
            return None
        row = dict(zip(COLUMNS, values, strict=True))
        return row | {"document": None if row["document"] is None else json.loads(row["document"])}

    def write(self, row: Mapping[str, Any]) -> None:
        """Write a row; it replaces that of the same folder."""
        document = row["document"]
        values = {**row, "document": None if document is None else json.dumps(document, allow_nan=False)}
        marks = ", ".join("?" * len(COLUMNS))
        with self._translate_errors():
            self._database.execute(
                f"INSERT OR REPLACE INTO runs ({', '.join(COLUMNS)}) VALUES ({marks})",
                [_to_text(values[name]) for name in COLUMNS],
            )

    @contextmanager
    def transaction(self) -> Iterator[None]:
        """Write rows together: all or none."""
        with self._translate_errors():
            self._database.execute("BEGIN")
            try:
                yield
            except BaseException:
                self._database.execute("ROLLBACK")
                raise
            self._database.execute("COMMIT")

    def _require_columns(self) -> None:
        found = [row[1] for row in self._database.execute("PRAGMA table_info(runs)")]
        if found != list(COLUMNS):
            raise InputError(self.path, f"expected a table runs with the columns {', '.join(COLUMNS)}, got another one")

    @contextmanager
    def _translate_errors(self) -> Iterator[None]:
        try:
            yield
        except sqlite3.OperationalError as error:
            raise OutputError(f"{self.path}: cannot be written: {error}") from None
        except sqlite3.DatabaseError as error:
            raise InputError(self.path, f"expected the journal of a batch: {error}") from None


def _to_text(value: Any) -> Any:  # noqa: ANN401
    """Return a value as SQLite can store it: bytes in the name of a file that are no text are escaped."""
    return value.encode("utf-8", "backslashreplace").decode("utf-8") if isinstance(value, str) else value


def describe_file(path: Path) -> str:
    """Size and time of modification of a file, or of all in a folder, as text; raises InputError if it is absent."""
    try:
        files = sorted(file for file in path.rglob("*") if file.is_file()) if path.is_dir() else [path]
        states = [(file.stat().st_size, file.stat().st_mtime_ns, file.name) for file in files]
    except OSError as error:
        raise InputError(path, f"cannot be read: {error.strerror}") from None
    if len(states) == 1:
        return f"{states[0][0]} {states[0][1]}"
    return json.dumps(states)
