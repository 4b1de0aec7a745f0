"""Which logs a batch has: paths, folders, patterns and manifests, and the name of the folder of each."""

from __future__ import annotations

import csv
import glob
import hashlib
import io
import os
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final, final

from gridslam.errors import InputError
from gridslam.io.text import read_text

COLUMNS: Final = ("log", "name", "reference")
"""Columns of a manifest beside the options of the command."""

_SUFFIXES: Final = (".clf", ".log", ".carmen", ".bag", ".mcap", ".db3", ".csv")
_PACKED: Final = (".gz", ".bz2")
_OWN_NAMES: Final = "runs."
"""Beginning of names that OUT needs for itself."""
_MOST_NAME_BYTES: Final = 200
"""Of a folder: file systems allow 255, and temporary folders have longer names."""
_LARGEST_MANIFEST: Final = 1 << 28


@final
@dataclass(frozen=True, slots=True)
class Entry:
    """One log of a batch.

    Attributes
    ----------
    log : str
        Path as the user gave it.
    path : str
        The same, absolute.
    name : str
        Name of the folder of its results, unique in the batch.
    reference : str or None
        Path of its relations or true trajectory, absolute.
    options : dict of str to str
        Options of the command by their long names without dashes, from a manifest.
    where : str
        Line of the manifest, for messages; empty for others.
    """

    log: str
    path: str
    name: str = ""
    reference: str | None = None
    options: dict[str, str] = field(default_factory=dict)
    where: str = ""


def find_logs(patterns: Sequence[str], *, reference: str | None = None) -> list[Entry]:
    """Find the logs of a batch and name them.

    A name is that of the file without suffixes; where two would be equal, the names of folders above precede it.

    Parameters
    ----------
    patterns : sequence of str
        Each a file, a folder (all logs below it; the folder of a ROS 2 bag is one log), a pattern (``*``, ``?``,
        ``[...]``, ``**``), or a manifest: a CSV with a column ``log`` and optionally ``name``, ``reference`` and
        options of the command. Paths in a manifest are relative to its folder.
    reference : str, optional
        Path of the reference of each log, with ``{name}`` (its name), ``{stem}`` (its file's without suffixes) and
        ``{parent}`` (its folder's).

    Raises
    ------
    InputError
        Nothing matches a pattern, a log is listed twice, or a manifest is malformed: names file and line.
    """
    entries = _name_all([entry for pattern in patterns for entry in _expand(pattern)])
    if reference is None:
        return entries
    return [entry if entry.reference else replace(entry, reference=_refer(reference, entry)) for entry in entries]


def _expand(pattern: str) -> Iterator[Entry]:
    path = Path(pattern)
    if not pattern:
        raise InputError(pattern, "expected a path, got an empty string")
    if os.path.isdir(path) and not (path / "metadata.yaml").exists():
        found = list(_walk(path))
        if not found:
            raise InputError(path, "no logs in this folder")
        yield from map(_make_entry, map(str, found))
    elif path.suffix == ".csv" and _is_manifest(path):
        yield from _read_manifest(path)
    elif glob.has_magic(pattern) and not os.path.exists(path):
        names = sorted(glob.glob(pattern, recursive=True))
        if not names:
            raise InputError(pattern, "nothing matches this pattern")
        for name in names:
            yield from _expand(name)
    else:  # one that is absent, or has an impossible name, is a row with an error
        yield _make_entry(pattern)


def _make_entry(path: str) -> Entry:
    return Entry(path, os.path.abspath(path))


def _walk(folder: Path) -> Iterator[Path]:
    """Yield the logs below a folder, by their names.

    Bags that are folders are not entered; results of gridslam are no logs.
    """
    if (folder / "run.json").exists():
        return
    try:
        content = sorted(folder.iterdir())
    except OSError:  # its job reports it
        yield folder
        return
    for path in content:
        if path.name.startswith("."):
            continue
        if (path / "metadata.yaml").exists() or (not path.is_dir() and _strip(path.name)[1] in _SUFFIXES):
            yield path
        elif path.is_dir() and path.resolve() not in path.absolute().parents:  # a link to a folder above has no end
            yield from _walk(path)


def _strip(name: str) -> tuple[str, str]:
    """Return a file's name without its suffixes, and the suffix without that of a compression."""
    stem, suffix = os.path.splitext(name)
    if suffix in _PACKED:
        stem, suffix = os.path.splitext(stem)
    return (stem, suffix) if suffix in _SUFFIXES else (name, "")


def _is_manifest(path: Path) -> bool:
    """Return whether a CSV has a column log."""
    try:
        with path.open(encoding="utf-8-sig", errors="replace") as file:
            header = next(csv.reader([file.readline(1 << 16)]), [])
    except (OSError, ValueError, csv.Error):
        return False  # its job reports it
    return "log" in map(str.strip, header)


def _read_manifest(path: Path) -> Iterator[Entry]:
    text = read_text(path, _LARGEST_MANIFEST).removeprefix("\ufeff")
    rows = csv.DictReader(io.StringIO(text, newline=""), strict=True, skipinitialspace=True)
    try:
        lines = [(rows.line_num, cells) for cells in rows]
    except csv.Error as error:
        raise InputError(path, f"expected a CSV: {error}", rows.reader.line_num) from None
    if not lines:
        raise InputError(path, "the manifest lists no logs")
    for line, cells in lines:
        if None in cells or None in cells.values():
            raise InputError(path, f"expected {len(rows.fieldnames or ())} cells", line)
        yield _read_line(path, line, {name.strip(): cell.strip() for name, cell in cells.items() if cell.strip()})


def _read_line(path: Path, line: int, given: dict[str, str]) -> Entry:
    if "log" not in given:
        raise InputError(path, "expected a path in the column log, got an empty cell", line)
    log = given.pop("log")
    name = given.pop("name", "")
    if name.startswith((".", _OWN_NAMES)) or {"/", "\\", "\0"} & set(name) or len(name.encode()) > _MOST_NAME_BYTES:
        expected = f"expected the name of a folder in the column name, of at most {_MOST_NAME_BYTES} bytes"
        raise InputError(path, f"{expected}, got {name!r}", line)
    reference = given.pop("reference", None)
    return Entry(
        log,
        os.path.abspath(path.parent / log),
        name,
        None if reference is None else os.path.abspath(path.parent / reference),
        given,
        f"{path}, line {line}",
    )


def _name_all(entries: Sequence[Entry]) -> list[Entry]:
    """Name those without a name; where names would be equal, all of them get longer ones."""
    candidates = [[entry.name] if entry.name else _list_names(entry) for entry in entries]
    while True:
        counts = Counter(names[0].casefold() for names in candidates)
        clashing = [names for names in candidates if counts[names[0].casefold()] > 1]
        longer = [names for names in clashing if len(names) > 1]
        if clashing and not longer:
            k = max(k for k, names in enumerate(candidates) if names in clashing)
            where = f"{entries[k].where}: " if entries[k].where else ""
            problem = "this log or its name is given twice; a column name in a manifest distinguishes logs"
            raise InputError(entries[k].log, f"{where}{problem}")
        if not clashing:
            return [replace(entry, name=names[0]) for entry, names in zip(entries, candidates, strict=True)]
        for names in longer:
            del names[0]


def _list_names(entry: Entry) -> list[str]:
    """Possible names of a log, from the shortest on."""
    path = entry.path
    parts = [part for part in path.replace("\\", "/").split("/") if part and not part.endswith(":")]
    *above, last = parts or ["log"]
    stem = _strip(last)[0].lstrip(".") or "log"
    names = [stem]
    for k in range(len(above) - 1, -1, -1):
        names += ["_".join([*above[k:], end]).lstrip(".") for end in (stem, last)]
    return [_shorten(f"log_{name}" if name.startswith(_OWN_NAMES) else name, path) for name in names]


def _shorten(name: str, path: str) -> str:
    """Shorten the name of a folder to the length of all file systems; a digest of the path keeps names distinct.

    Letters that are no text are those of a file name in another encoding.
    """
    encoded = name.encode("utf-8", "replace")
    if len(encoded) <= _MOST_NAME_BYTES and encoded.decode() == name:
        return name
    digest = hashlib.sha256(os.fsencode(path)).hexdigest()[:12]
    return f"{encoded[: _MOST_NAME_BYTES - 13].decode('utf-8', 'ignore')}-{digest}"


def _refer(pattern: str, entry: Entry) -> str:
    path = Path(entry.path)
    values = {"name": entry.name, "stem": _strip(path.name)[0], "parent": path.parent.name}
    try:
        return os.path.abspath(pattern.format(**values))
    except (KeyError, IndexError, ValueError):
        raise InputError(pattern, "expected a path with {name}, {stem} or {parent}") from None
