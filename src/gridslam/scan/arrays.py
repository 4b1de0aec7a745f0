"""The kinds of arrays that scans, poses and maps consist of."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["FloatArray", "IntArray", "Rows"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Rows = NDArray[np.integer[Any]]
"""Which map of a table of maps: one row for each pose."""
