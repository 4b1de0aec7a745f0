"""The lines of g2o's text form that planar pose graphs have."""

from __future__ import annotations

import textwrap
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from gridslam.errors import InputError
from gridslam.io.measurement import FARTHEST_M
from gridslam.io.text import TextSource
from gridslam.types import FloatArray, IntArray

__all__ = ["EDGE", "FIX", "VERTEX", "TaggedRows", "read_rows"]

VERTEX, EDGE, FIX = "VERTEX_SE2", "EDGE_SE2", "FIX"

_FIELDS = {VERTEX: "id x y theta", EDGE: "from to x y theta I_xx I_xy I_xt I_yy I_yt I_tt", FIX: "id"}
_WIDTHS = {tag: len(fields.split()) for tag, fields in _FIELDS.items()}
_IDS = {VERTEX: 1, EDGE: 2, FIX: 1}
_MOST = 1e30  # squares of errors, times this, are still numbers


class TaggedRows(NamedTuple):
    """Lines of one tag: ids (K, 1 or 2) int64, numbers (K, V) float64, line numbers (K,)."""

    ids: IntArray
    values: FloatArray
    lines: list[int]


class _RowBuffer(NamedTuple):
    """The same, one value after another: a list for each row would cost more than its numbers."""

    ids: list[int]
    values: list[float]
    lines: list[int]


def read_rows(path: str | Path, skip_unknown: bool) -> tuple[dict[str, TaggedRows], dict[str, int]]:
    """Read the lines of each known tag, and count those of each unknown one; raises InputError as `read_g2o`."""
    found = {tag: _RowBuffer([], [], []) for tag in _FIELDS}
    skipped = Counter[str]()
    for number, line in _numbered(path):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        if (tag := words[0]) in found:
            ids, values = _parsed(path, tag, words, line, number)
            found[tag].ids.extend(ids)
            found[tag].values.extend(values)
            found[tag].lines.append(number)
        elif skip_unknown:
            skipped[tag] += 1
        else:
            problem = f"expected the tag {VERTEX}, {EDGE} or {FIX}, got {textwrap.shorten(tag, 40)!r}"
            raise InputError(path, f"{problem} (--skip-unknown passes over such lines and counts them)", number)
    return {tag: _table(path, tag, rows) for tag, rows in found.items()}, dict(skipped)


def _numbered(path: str | Path) -> Iterator[tuple[int, str]]:
    """Lines with their numbers, from 1; a file whose compressed end is missing is refused."""
    source, number = TextSource(path), 0
    for block in source:
        if source.is_truncated:  # what is left is the beginning of a line
            break
        yield from enumerate(block, number + 1)
        number += len(block)
    if source.is_truncated:
        raise InputError(path, "expected a whole file, got one whose compressed end is missing", number)


def _parsed(path: str | Path, tag: str, words: list[str], line: str, number: int) -> tuple[list[int], list[float]]:
    """Ids and numbers of a line."""
    split = 1 + _IDS[tag]
    # Python reads 1_000 as a number; the format knows no such thing.
    if len(words) == 1 + _WIDTHS[tag] and line.count("_") == tag.count("_"):
        try:
            ids = [int(word) for word in words[1:split]]
            if min(ids) >= 0 and max(ids) < 2**63:
                return ids, [float(word) for word in words[split:]]
        except ValueError:
            pass
    raise InputError(path, f"expected '{tag} {_FIELDS[tag]}', got {textwrap.shorten(line, 100)!r}", number)


def _table(path: str | Path, tag: str, found: _RowBuffer) -> TaggedRows:
    ids = np.array(found.ids, np.int64).reshape(-1, _IDS[tag])
    values = np.array(found.values, np.float64).reshape(len(ids), _WIDTHS[tag] - _IDS[tag])
    possible = (np.abs(values[:, :3]) <= FARTHEST_M).all(axis=1) & (np.abs(values[:, 3:]) <= _MOST).all(axis=1)
    if len(bad := np.flatnonzero(~possible)):
        got = " ".join(f"{value:g}" for value in values[bad[0]])
        most = f"numbers up to {FARTHEST_M:g} m and rad" + f", information up to {_MOST:g}" * (tag == EDGE)
        raise InputError(path, f"expected {most} for {tag} {_FIELDS[tag]}, got {got}", found.lines[bad[0]])
    return TaggedRows(ids, values, found.lines)
