"""Rows of numbers, read a piece at a time."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import NamedTuple

from gridslam.errors import InputError
from gridslam.io.carmen.lines import LineError, parse_stamp_ns
from gridslam.io.text import TextSource

__all__ = ["NumberRow", "read_numbered_lines", "read_stamped_rows"]


class NumberRow(NamedTuple):
    """A stamp (ns), the numbers after it, and the line they stand on."""

    stamp_ns: int
    values: list[float]
    line: int


def read_numbered_lines(path: str | Path) -> Iterator[tuple[int, str]]:
    """Yield the data lines with their numbers; blank ones and those that begin with # do not.

    Raises InputError where the file cannot be read, or ends in the middle.
    """
    source, number = TextSource(path), 0
    for line in chain.from_iterable(source):
        number += 1
        if source.is_truncated:  # what is left of a line
            break
        if line.strip() and not line.lstrip().startswith("#"):
            yield number, line
    if source.is_truncated:
        raise InputError(path, "the compressed file ends in the middle", number)


def read_stamped_rows(path: str | Path, columns: str) -> Iterator[NumberRow]:
    """Yield rows of white-space separated numbers, the first of which is a stamp in seconds that never goes back.

    Raises
    ------
    InputError
        With the line, where a row has other columns than `columns` names, a value that is no finite number, or a stamp
        before that of the row above it.
    """
    width, last = len(columns.split()), -(2**63)
    for number, line in read_numbered_lines(path):
        words = line.split()
        if len(words) != width:
            raise InputError(path, f"expected {width} numbers ({columns}), got {len(words)}", number)
        try:
            row = NumberRow(parse_stamp_ns(words[0]), [float(word) for word in words[1:]], number)
        except LineError as error:
            raise InputError(path, str(error), number) from None
        except ValueError:
            raise InputError(path, f"expected numbers ({columns}), got {line!r:.200}", number) from None
        if not all(map(math.isfinite, row.values)):
            raise InputError(path, f"expected finite numbers ({columns}), got {line!r:.200}", number)
        if row.stamp_ns < last:
            raise InputError(path, f"expected stamps in order, got {words[0]} after a later one", number)
        last = row.stamp_ns
        yield row
