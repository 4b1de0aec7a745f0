"""Several scans side by side in memory, as the kernels take them in one call."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate
from typing import NamedTuple, final

import numpy as np

from gridslam.types import BeamEnds, FloatArray, IntArray


@final
class ScanBatch(NamedTuple):
    """K scans with B beams in all.

    Attributes
    ----------
    ends : (B, 2) float64, m
        Ends of the beams, each in the base frame of its scan, scan after scan.
    starts : (K + 1,) int64
        Scan k has ends starts[k] to starts[k + 1] - 1.
    origins : (K, 2) float64, m
        Where the laser was.
    """

    ends: FloatArray
    starts: IntArray
    origins: FloatArray

    @classmethod
    def of(cls, scans: Sequence[BeamEnds]) -> ScanBatch:
        """Put scans side by side."""
        starts = np.array([0, *accumulate(map(len, scans))], np.int64)
        ends = np.concatenate([np.empty((0, 2)), *(scan.ends for scan in scans)])
        return cls(ends, starts, np.array([scan.origin for scan in scans], np.float64).reshape(-1, 2))
