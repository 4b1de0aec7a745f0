"""Twin of the kernel that parses numbers in text."""

from __future__ import annotations

import re

import numpy as np

from gridslam.kernels.reference_update import FloatArray

__all__ = ["parse_numbers"]

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
