"""Text tables of numbers whose first columns are stamps."""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from gridslam.errors import InputError
from gridslam.io.carmen.lines import LineError, parse_stamp_ns
from gridslam.io.text import read_text
from gridslam.types import FloatArray, IntArray

__all__ = ["Table", "read_table"]


class Table(NamedTuple):
    """Stamps (N, S) int64 ns, values (N, V) float64 and line numbers (N,) of a table's rows."""

    stamps_ns: IntArray
    values: FloatArray
    lines: list[int]


def read_table(path: str | Path, stamps: int, columns: str) -> Table:
    """Read rows of white-space separated numbers; blank lines and those that begin with # are left out.

    Parameters
    ----------
    path : str or Path
        A text file.
    stamps : int
        How many of the columns, from the left, are stamps in seconds; they are read exactly.
    columns : str
        Names of all columns.

    Raises
    ------
    InputError
        With the line, where a row has another number of columns or a value that is no finite number; without, where the
        file cannot be read or has no row.
    """
    width = len(columns.split())
    times, values, lines = list[list[int]](), list[list[float]](), list[int]()
    for number, line in enumerate(read_text(path).splitlines(), 1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        if len(words) != width:
            raise InputError(path, f"expected {width} numbers ({columns}), got {len(words)}", number)
        try:
            times.append([parse_stamp_ns(word) for word in words[:stamps]])
            values.append([float(word) for word in words[stamps:]])
        except LineError as error:
            raise InputError(path, str(error), number) from None
        except ValueError:
            raise InputError(path, f"expected numbers ({columns}), got {line!r}", number) from None
        if not all(map(math.isfinite, values[-1])):
            raise InputError(path, f"expected finite numbers ({columns}), got {line!r}", number)
        lines.append(number)
    if not lines:
        raise InputError(path, f"expected rows of {columns}, got none")
    return Table(np.array(times, dtype=np.int64), np.array(values), lines)
