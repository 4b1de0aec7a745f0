"""Twins of the kernels that read and write numbers in text."""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from gridslam.kernels.reference_update import FloatArray

_LONGEST = 32
_NUMBER = re.compile(r"-?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]{1,2})?")


def parse_numbers(text: bytes, rows: int) -> FloatArray:
    """Numbers (K, L) of `rows` lines of text, separated by blanks.

    They are (0, 0) where a word is no plain decimal number of at most 32 characters and an exponent of at most two
    digits, where lines have other numbers of words than the first, and where there are other numbers of lines.
    """
    lines = [line.split(" ") for line in text.decode("latin-1").split("\n")]
    words = [[word for word in line if word] for line in lines]
    is_plain = all(len(word) <= _LONGEST and _NUMBER.fullmatch(word) for line in words for word in line)
    columns = len(words[0])
    if len(words) != rows or not columns or not is_plain or any(len(line) != columns for line in words):
        return np.zeros((0, 0))
    return np.array([[float(word) for word in line] for line in words])


def format_rows(stamps_ns: NDArray[np.int64], values: FloatArray, is_fixed: NDArray[np.bool_], separator: str) -> bytes:
    """A line of text for each row: its stamp (ns) in s with nine decimals, exact, and its values (N, K).

    Words are separated by a character; numbers have nine decimals where their column is fixed (K,), else nine
    significant digits; as C's printf has them, but a NaN has no sign.
    """
    sizes = np.abs(stamps_ns).view(np.uint64)  # that of the least int64 fits no int64
    seconds, nanoseconds = np.divmod(sizes, np.uint64(10**9))
    signs = np.where(stamps_ns < 0, "-", "").tolist()
    columns = signs, seconds.tolist(), nanoseconds.tolist(), *values.T.tolist()
    form = separator.join(["%s%d.%09d", *("%.9f" if fixed else "%.9g" for fixed in is_fixed)]) + "\n"
    return "".join(map(form.__mod__, zip(*columns, strict=True))).encode()
