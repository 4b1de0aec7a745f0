"""Numbers in text: stamps, and tables of rows with white space or commas between their numbers."""

from __future__ import annotations

import math
import textwrap
from array import array
from collections.abc import Callable, Iterator, Sequence
from decimal import Context, Decimal
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from gridslam.errors import InputError
from gridslam.io.limits import describe_bytes, max_memory_bytes
from gridslam.io.text import read_numbered_lines
from gridslam.types import FloatArray, IntArray

_CHECKED_ROWS = 1 << 16
_EXACT = Context(prec=1000)  # digits
_STAMPS_NS = Decimal(-(2**63)), Decimal(2**63)  # range of 64 bits


class Row(NamedTuple):
    """Stamps of a row in ns, the numbers after them, and the line on which they stand."""

    stamps_ns: list[int]
    values: list[float]
    line: int


class Table(NamedTuple):
    """Stamps (N, S) int64 ns, values (N, V) float64 and line numbers (N,) of a table's rows."""

    stamps_ns: IntArray
    values: FloatArray
    lines: Sequence[int]


def parse_stamp_ns(text: str) -> int:
    """Convert a decimal number of seconds to nanoseconds, exactly; raises ValueError, with the expected form."""
    seconds, _, fraction = text.partition(".")
    if seconds.isdecimal() and fraction.isdecimal() and len(seconds) <= 10 and len(fraction) <= 9:  # the usual form
        stamp_ns = int(seconds) * 10**9 + int(fraction.ljust(9, "0"))
        if stamp_ns < _STAMPS_NS[1]:
            return stamp_ns
    try:
        value = Decimal(text).scaleb(9, _EXACT)
        if _STAMPS_NS[0] <= value < _STAMPS_NS[1]:
            return int(value)
    except ArithmeticError:
        pass
    raise ValueError(f"expected a stamp in seconds that fits 64 bits of nanoseconds, got {text!r}")


def format_stamp_ns(stamp_ns: int, decimals: int = 6) -> str:
    """Exact decimal seconds, with `decimals` digits after the point, or nine where they are needed."""
    seconds, nanoseconds = divmod(abs(stamp_ns), 10**9)
    digits = 9 if nanoseconds % 10 ** (9 - decimals) else decimals
    return f"{'-' if stamp_ns < 0 else ''}{seconds}.{f'{nanoseconds:09d}'[:digits]}"


def parse_whole_ns(text: str) -> int:
    """Convert a stamp that is written in whole nanoseconds; raises ValueError, with the expected form."""
    if text.strip().isdecimal() and len(text) <= 20 and int(text) < _STAMPS_NS[1]:
        return int(text)
    raise ValueError(f"expected a stamp in whole nanoseconds that fits 64 bits, got {text!r:.60}")


def read_rows(
    path: str | Path,
    columns: str,
    stamps: int = 0,
    *,
    in_order: bool = False,
    parse_stamp: Callable[[str], int] = parse_stamp_ns,
    split: Callable[[str], list[str]] | None = None,
    skip: Callable[[str], bool] = lambda line: False,
) -> Iterator[Row]:
    """Read rows of finite numbers, a piece at a time.

    Parameters
    ----------
    path : str or Path
        A text file, plain, gzip or bzip2.
    columns : str
        Names of all columns. With commas between them they are the file's first line, and each line after it is a row;
        with blanks, blank lines and those that begin with # are left out.
    stamps : int
        How many of the columns, from the left, are stamps in seconds; they are read exactly.
    in_order : bool
        Whether the first stamp must never go back.
    parse_stamp : callable
        Reads a stamp.
    split : callable, optional
        Splits a line into its cells, where not by blanks or commas.
    skip : callable
        Returns whether a line is no row, and left out.

    Raises
    ------
    InputError
        With the line, where a row has another number of columns, a value that is no finite number, or a stamp before
        that of the row above it; without, where the file cannot be read.
    """
    separator = "," if "," in columns else None
    lines = read_numbered_lines(path, with_comments=separator is not None)
    if separator and (header := next(lines, (1, ""))[1]) != columns:
        raise InputError(path, f"expected the columns {columns}, got {header!r:.200}", 1)
    width = len(columns.split(separator))
    last_ns = -(2**63)
    for number, line in lines:
        if skip(line):
            continue
        words = split(line) if split else line.split(separator)
        if len(words) != width:
            raise InputError(path, f"expected {width} numbers ({columns}), got {len(words)}", number)
        try:
            stamps_ns = [parse_stamp(word) for word in words[:stamps]]
        except ValueError as error:
            raise InputError(path, str(error), number) from None
        try:
            values = [float(word) for word in words[stamps:]]
        except ValueError:
            raise InputError(path, f"expected numbers ({columns}), got {line!r:.200}", number) from None
        if not all(map(math.isfinite, values)):
            raise InputError(path, f"expected finite numbers ({columns}), got {line!r:.200}", number)
        if in_order:
            if stamps_ns[0] < last_ns:
                raise InputError(path, f"expected stamps in order, got {words[0]} after a later one", number)
            last_ns = stamps_ns[0]
        yield Row(stamps_ns, values, number)


def parse_tagged(path: str | Path, number: int, line: str, ids: str, values: str) -> tuple[list[int], list[float]]:
    """Parse the ids and the numbers that follow a line's tag.

    Parameters
    ----------
    path : str or Path
        The file, and
    number : int
        the number of the line, for the error.
    line : str
        The line, with its tag.
    ids, values : str
        Names of the columns of whole numbers >= 0 of 64 bits, and of those of other numbers.

    Raises
    ------
    InputError
        The line has other columns.
    """
    tag, *words = line.split()
    split = len(ids.split())
    try:
        # Python reads 1_000 as a number; the formats know no such thing.
        if len(words) == split + len(values.split()) and not any("_" in word for word in words):
            names = [int(word) for word in words[:split]]
            if min(names) >= 0 and max(names) < 2**63:
                return names, [float(word) for word in words[split:]]
    except ValueError:
        pass
    expected = " ".join([tag, *ids.split(), *values.split()])
    raise InputError(path, f"expected '{expected}', got {textwrap.shorten(line, 100)!r}", number)


def read_table(path: str | Path, columns: str, stamps: int = 0, **how: Any) -> Table:  # noqa: ANN401
    """Read all rows of a table; as `read_rows`, and raises InputError where there is none."""
    stamps_ns = array("q")
    values = array("d")
    lines = array("q")
    most = max_memory_bytes() // 2  # the arrays are copied once
    for row in read_rows(path, columns, stamps, **how):
        stamps_ns.extend(row.stamps_ns)
        values.extend(row.values)
        lines.append(row.line)
        if len(lines) % _CHECKED_ROWS == 0 and 8 * (len(stamps_ns) + len(values) + len(lines)) > most:
            problem = f"expected a table that takes less than the {describe_bytes(2 * most)} of --max-memory"
            raise InputError(path, problem, row.line)
    if not lines:
        raise InputError(path, f"expected rows of {columns}, got none")
    rows = len(lines)
    return Table(np.array(stamps_ns, np.int64).reshape(rows, stamps), np.array(values).reshape(rows, -1), lines)


def check_rows(path: str | Path, lines: Sequence[int], good: ArrayLike, describe: Callable[[int], str]) -> None:
    """Raise InputError for the first row that is not `good` (N,), with its line and the text that `describe` gives."""
    bad = np.flatnonzero(~np.asarray(good))
    if len(bad):
        raise InputError(path, describe(int(bad[0])), lines[bad[0]])


def upper_of_symmetric(matrices: FloatArray) -> FloatArray:
    """Upper triangles (..., S), row by row, of symmetric matrices (..., K, K)."""
    rows, columns = np.triu_indices(matrices.shape[-1])
    return np.asarray(matrices[..., rows, columns])


def symmetric_of_upper(upper: FloatArray) -> FloatArray:
    """Symmetric matrices (..., K, K) of their upper triangles (..., S), row by row."""
    size = math.isqrt(2 * upper.shape[-1])
    rows, columns = np.triu_indices(size)
    matrices = np.empty((*upper.shape[:-1], size, size))
    matrices[..., rows, columns] = upper
    matrices[..., columns, rows] = upper
    return matrices
