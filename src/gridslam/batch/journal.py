"""The journal of a batch, OUT/runs.sqlite: a row for each job that has ended."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, final

from gridslam.errors import InputError, OutputError
from gridslam.io.database import open_database
from gridslam.io.text import parse_json, refuse_unreadable

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

    A process that is killed leaves it consistent.

    Parameters
    ----------
    folder : Path
        OUT; created if missing.

    Raises
    ------
    OutputError
        It cannot be written: the disk is full, or a file of this name is no journal. `write` raises it, too.
    """

    def __init__(self, folder: Path) -> None:
        """Open the journal, or create it."""
        self.path = folder / JOURNAL
        columns = ", ".join(f"{name} {kind}" for name, kind in COLUMNS.items())
        with self._translate_errors():
            folder.mkdir(parents=True, exist_ok=True)
            self._database = sqlite3.connect(self.path, timeout=30, isolation_level=None)
            self._database.execute(f"CREATE TABLE IF NOT EXISTS runs ({columns})")

    def __enter__(self) -> Journal:
        """Return the journal itself."""
        return self

    def __exit__(self, *error: object) -> None:
        """Close the file."""
        self._database.close()

    def write(self, row: Mapping[str, Any]) -> None:
        """Write a row; it replaces that of the same folder."""
        document = row["document"]
        values = {**row, "document": None if document is None else json.dumps(document, allow_nan=False)}
        names = ", ".join(COLUMNS)
        with self._translate_errors():
            self._database.execute(
                f"INSERT OR REPLACE INTO runs ({names}) VALUES ({', '.join('?' * len(COLUMNS))})",
                [_to_text(values[name]) for name in COLUMNS],
            )

    @contextmanager
    def _translate_errors(self) -> Iterator[None]:
        try:
            yield
        except (sqlite3.Error, OSError) as error:
            raise OutputError(f"{self.path}: cannot be written: {getattr(error, 'strerror', error)}") from None


def read_rows(out: str | Path) -> Iterator[dict[str, Any]]:
    """Yield the rows of a batch in the order of their first start; their documents are objects.

    Parameters
    ----------
    out : str or Path
        Output folder of `gridslam batch`.

    Raises
    ------
    InputError
        There is no journal in the folder, it is damaged, or it lacks a column.
    """
    path = Path(out) / JOURNAL
    if not path.is_file():
        raise InputError(path, "no such file: expected the journal of gridslam batch")
    try:
        with closing(open_database(path, ["runs"], "mode=ro")) as database:
            for values in database.execute(f"SELECT {', '.join(COLUMNS)} FROM runs ORDER BY started, log, key"):
                row = dict(zip(COLUMNS, values, strict=True))
                with refuse_unreadable(path, f"a document in JSON of {row['log']}"):
                    document = parse_json(row["document"] or "{}", odd_names=True)
                yield row | {"document": document if isinstance(document, dict) else {}}
    except sqlite3.Error as error:
        raise InputError(path, f"expected a journal of gridslam batch, got: {error}") from None


def _to_text(value: Any) -> Any:  # noqa: ANN401
    """Return a value as SQLite can store it: bytes in the name of a file that are no text are escaped."""
    return value.encode("utf-8", "backslashreplace").decode("utf-8") if isinstance(value, str) else value
