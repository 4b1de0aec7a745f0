"""SQLite files whose schema computes, or says one thing and is another, or whose pages refer to each other."""

from __future__ import annotations

import random
import shutil
import sqlite3
from collections.abc import Iterator
from contextlib import closing, suppress
from functools import partial
from pathlib import Path

import numpy as np

from gridslam.batch.journal import JOURNAL, Journal
from gridslam.batch.runs import read_runs
from gridslam.errors import OutputError
from gridslam.io.log import LogOptions, open_log
from support import ros_bags
from support.fuzz_commands import Prepare, Read
from support.journals import make_rows, write_journal

__all__ = ["schemas"]

_MOST_PAGES = 4000  # 16 MB
_ENDLESS = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n)"
_MANY = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < 300)"
_COLUMNS = {
    "messages": "{n} AS id, 1 AS topic_id, {n} * 1000 AS timestamp, {data} AS data",
    "topics": "{n} AS id, '/scan' || {n} AS name, 'sensor_msgs/msg/LaserScan' AS type, 'cdr' AS serialization_format",
    "runs": "{n} AS key, 'a' AS log, 'map' AS command, 'f' || {n} AS folder, 'done' AS status, {data} AS document",
}
_DATA = ("zeroblob(900000000)", "randomblob(10)", "replace(hex(zeroblob(1000000)), '0', 'xxxxxxxxxx')", "NULL", "x''")
_LIES = (
    "CREATE VIEW {name} AS {select}", "create view {name} as {select}", "CREATE/**/VIEW {name} AS {select}",
    "CREATE TEMP VIEW {name} AS {select}", "CREATE TABLE {name} AS {select}",
    "CREATE VIRTUAL TABLE {name} USING fts5(id, data)", "CREATE TABLE x(y); CREATE VIEW {name} AS {select}",
    "-- \nCREATE VIEW {name} AS {select}", "CREATE VIEW main.{name} AS {select}",
    "CREATE TRIGGER {name} AFTER INSERT ON t0 BEGIN SELECT 1; END",
    "CREATE TABLE {name}(id, data AS (zeroblob(900000000)))",
)  # fmt: skip


def schemas(folder: Path) -> Iterator[tuple[str, int, Prepare, Read, float]]:
    """Name, point of the report, the two functions and the weight of each family."""
    (bag,) = ros_bags.write(folder, "db3", ros_bags.drive(1.0), name="schemas").glob("*.db3")
    (folder / "journal").mkdir()
    write_journal(folder / "journal", make_rows(5, 1))
    yield "schemas of bags", 6, partial(_prepare, bag, ("messages", "topics")), _read_bag, 2.0
    yield "schemas of journals", 6, partial(_prepare, folder / "journal" / JOURNAL, ("runs",)), _read_journal, 0.5


def _prepare(whole: Path, tables: tuple[str, ...], to: Path, rng: np.random.Generator) -> None:
    path = to / whole.name
    shutil.copy(whole, path)
    for _ in range(rng.integers(1, 3)):
        table = tables[rng.integers(len(tables))]
        change = _CHANGES[rng.integers(len(_CHANGES))]
        with closing(sqlite3.connect(path)) as database, suppress(sqlite3.Error, LookupError):
            steps = iter(range(1000))  # what is made here may not end, either
            database.set_progress_handler(lambda steps=steps: next(steps, None) is None, 1000)  # type: ignore[misc]
            database.execute(f"PRAGMA max_page_count = {_MOST_PAGES}")
            change(database, table, rng)
            database.commit()
    if rng.integers(4) == 0:
        _refer_elsewhere(path, rng)


def _spell(name: str, rng: np.random.Generator) -> str:
    """The name with some letters in capitals, and quoted in one of SQLite's ways."""
    letters = random.Random(int(rng.integers(1 << 30)))
    spelt = "".join(letters.choice((letter, letter.upper())) for letter in name)
    return ("{}", '"{}"', "[{}]", "`{}`", "'{}'")[rng.integers(5)].format(spelt)


def _select(table: str, rng: np.random.Generator) -> str:
    data = _DATA[rng.integers(len(_DATA))]
    columns = _COLUMNS[table].format(n="i", data=data)
    return f"{(_ENDLESS, _MANY)[rng.integers(2)]} SELECT {columns} FROM n"


def _view(database: sqlite3.Connection, table: str, rng: np.random.Generator) -> None:
    database.execute(f"ALTER TABLE {table} RENAME TO t0")
    database.execute(f"CREATE VIEW {_spell(table, rng)} AS {_select(table, rng)}")


def _lie(database: sqlite3.Connection, table: str, rng: np.random.Generator) -> None:
    """A row of the schema whose statement is none of a table, whatever its type and name are."""
    statement = _LIES[rng.integers(len(_LIES))].format(name=_spell(table, rng), select=_select(table, rng))
    database.execute("PRAGMA writable_schema=ON")
    sql: object = statement.encode() if rng.integers(4) == 0 else statement
    if rng.integers(2):
        database.execute("UPDATE sqlite_master SET sql = ? WHERE name = ?", (sql, table))
    else:
        kind, name = (("table", "t1"), ("view", table), ("index", "t2"), ("table", table.upper()))[rng.integers(4)]
        database.execute("UPDATE sqlite_master SET name = 't0' WHERE name = ?", (table,))
        database.execute("INSERT INTO sqlite_master VALUES (?, ?, ?, 0, ?)", (kind, name, name, sql))


def _virtual(database: sqlite3.Connection, table: str, rng: np.random.Generator) -> None:
    database.execute(f"DROP TABLE {table}")
    module = ("fts4", "fts5", "rtree", "dbstat", "json_each", "geopoly")[rng.integers(6)]
    columns = "" if module == "dbstat" else "(id, topic_id, timestamp, data)"
    database.execute(f"CREATE VIRTUAL TABLE {_spell(table, rng)} USING {module}{columns}")


def _generate(database: sqlite3.Connection, table: str, rng: np.random.Generator) -> None:
    stored = ("STORED", "VIRTUAL", "")[rng.integers(3)]
    data = ("zeroblob(900000000)", "hex(zeroblob(400000000))", "id + 1")[rng.integers(3)]
    name = _spell(table, rng)
    if rng.integers(2):
        database.execute(f"ALTER TABLE {table} ADD COLUMN more AS ({data})")
        return
    database.execute(f"DROP TABLE {table}")
    database.execute(
        f"CREATE TABLE {name}(id INTEGER, topic_id INTEGER, timestamp INTEGER, name, type, data AS ({data}) {stored})"
    )
    database.executemany(f"INSERT INTO {name}(id, topic_id, timestamp) VALUES (?, 1, ?)", [(k, k) for k in range(2)])


def _trigger(database: sqlite3.Connection, table: str, rng: np.random.Generator) -> None:
    database.execute(f"CREATE TRIGGER t AFTER INSERT ON {table} BEGIN INSERT INTO {table} SELECT * FROM {table}; END")


def _fill_up(database: sqlite3.Connection, table: str, rng: np.random.Generator) -> None:
    """Values of other types, lengths and signs; the same row again and again."""
    columns = [row[1] for row in database.execute(f"PRAGMA table_info({table})")]
    values: tuple[object, ...] = (
        None,
        "x",
        "x" * 3_000_000,
        b"",
        bytes(2_000_000),
        -1,
        2**62,
        1.5,
        "\ud7ff",
        b"\xff" * 9,
    )
    for column in columns:
        if rng.integers(2):
            with suppress(sqlite3.Error):
                database.execute(f"UPDATE {table} SET {column} = ?", (values[rng.integers(len(values))],))


def _multiply(database: sqlite3.Connection, table: str, rng: np.random.Generator) -> None:
    """A table without keys that holds each row thousands of times."""
    columns = ", ".join(row[1] for row in database.execute(f"PRAGMA table_info({table})"))
    database.execute(f"CREATE TABLE copy AS SELECT {columns} FROM {table} LIMIT 1")
    database.execute(f"DROP TABLE {table}")
    database.execute(f"ALTER TABLE copy RENAME TO {table}")
    for _ in range(rng.integers(6, 14)):
        database.execute(f"INSERT INTO {table} SELECT * FROM {table} WHERE rowid < 5000")


def _default(database: sqlite3.Connection, table: str, rng: np.random.Generator) -> None:
    """Rows that end early: their last columns are what the schema says, megabytes."""
    text = "x" * int(rng.choice([1000, 400_000]))
    value = f"x'{'00' * len(text)}'" if rng.integers(2) else f"'{text}'"
    database.execute("CREATE TABLE copy(id INTEGER, topic_id INTEGER, timestamp INTEGER, name, type)")
    database.executemany("INSERT INTO copy VALUES (?, 1, ?, 'a', 'b')", [(k, k) for k in range(20_000)])
    database.execute(f"ALTER TABLE copy ADD COLUMN data DEFAULT {value}")
    database.execute(f"DROP TABLE {table}")
    database.execute(f"ALTER TABLE copy RENAME TO {table}")


def _index(database: sqlite3.Connection, table: str, rng: np.random.Generator) -> None:
    column = database.execute(f"PRAGMA table_info({table})").fetchall()[-1][1]
    what = (f"{column}", f"length({column})", f"zeroblob(length({column}))", f"{column}) WHERE ({column} IS NOT NULL")
    database.execute(f"CREATE {('', 'UNIQUE')[rng.integers(2)]} INDEX i0 ON {table}({what[rng.integers(len(what))]})")


_CHANGES = (_view, _view, _lie, _lie, _lie, _virtual, _generate, _trigger, _fill_up, _multiply, _default, _index)


def _refer_elsewhere(path: Path, rng: np.random.Generator) -> None:
    """Pages that are other pages, or name others as what is below them."""
    content = bytearray(path.read_bytes())
    size = int.from_bytes(content[16:18], "big") or 4096
    pages = len(content) // max(size, 512)
    for _ in range(rng.integers(1, 6)):
        page, other = (int(rng.integers(pages)) * size for _ in range(2))
        if page and rng.integers(2):
            content[page : page + size] = content[other : other + size] if other else content[100 : 100 + size]
        else:
            place = page + int(rng.integers(size - 4))
            content[place : place + 4] = int(rng.integers(1, pages + 2)).to_bytes(4, "big")
    path.write_bytes(content)


def _read_bag(where: Path) -> None:
    (path,) = where.glob("*.db3")
    for keep in (True, False):
        for _ in open_log(path, LogOptions(keep_truncated=keep)):
            pass


def _read_journal(where: Path) -> None:
    try:
        with Journal(where) as journal:
            journal.find("f1")
    except OutputError:  # as where a disk is full
        pass
    for _ in read_runs(where):
        pass
