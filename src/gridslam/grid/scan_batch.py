"""Several scans side by side in memory, as the kernels take them in one call."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate
from typing import NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from gridslam.types import BeamEnds, FloatArray, IntArray, StoredScan


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
        if len(scans) == 1:  # as a tracker has it at every scan
            return cls(scans[0].ends, starts, scans[0].origin.reshape(1, 2))
        ends = np.concatenate([np.empty((0, 2)), *(scan.ends for scan in scans)])
        return cls(ends, starts, np.array([scan.origin for scan in scans], np.float64).reshape(-1, 2))

    @property
    def size(self) -> int:
        """Number of scans."""
        return len(self.origins)

    @property
    def reach_m(self) -> float:
        """Distance of the farthest end or laser from its base."""
        if not self.size:
            return 0.0
        squared = np.square(self.ends), np.square(self.origins)
        return float(np.sqrt(max((xy[:, 0] + xy[:, 1]).max(initial=0.0) for xy in squared)))

    def scan(self, k: int) -> StoredScan:
        """Scan k alone."""
        return StoredScan(self.ends[self.starts[k] : self.starts[k + 1]], self.origins[k])


@final
class Weighing(NamedTuple):
    """Weights of the beams of a batch that is weighed while it is drawn.

    Attributes
    ----------
    after : (K,) int64
        Scan k is weighed as soon as this many are drawn, ascending; never where that is none, or beyond the last.
    weights : (B,) float32
        For each beam 1 / (1 + (d / scale_m)^2), d its distance to the nearest obstacle; -1 where it ends in an unknown
        cell, and where its scan is not weighed.
    scale_m : float, m
        Distance at which a beam weighs half.
    """

    after: IntArray
    weights: NDArray[np.float32]
    scale_m: float

    @classmethod
    def of(cls, batch: ScanBatch, after: IntArray, scale_m: float) -> Weighing:
        """Weigh nothing yet."""
        return cls(after, np.full(len(batch.ends), -1, np.float32), scale_m)


NOT_WEIGHED = Weighing(np.empty(0, np.int64), np.empty(0, np.float32), 1.0)
