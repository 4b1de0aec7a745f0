"""Order and duration of the beams of a scan, estimated from which order fits the map best."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import final

import numpy as np

from gridslam.doctor.lasers import field_of_view_rad
from gridslam.types import FloatArray, IntArray, LaserScan

__all__ = ["BeamOrder", "BeamTimes"]

_FEWEST, _ENOUGH = 25, 300  # informative scans: more than one turn has, and the largest number used
_SWEEPS, _GAIN = 0.2, 0.01
"""Share of the presumed time, and of the beams that agree more in order than backward, from which on scans are swept.
Maps drawn from bent scans hide up to three fourths of it: 0.25 to 1, and 0.017 to 0.28, were measured of lasers that
sweep so long. Of others none had both: up to 0.11 of those that sweep faster, 0.19 in slow turns."""
_SIGMAS = 4.0
_SMEAR_RAD = 0.02  # turned while a scan is taken: ends 5 m away are moved by two cells


@final
@dataclass(slots=True)
class BeamTimes:
    """Beam times of a laser: as reported by its scans, or as of a mirror that turns once per scan.

    Attributes
    ----------
    order : BeamOrder
        Estimate from the scans.
    period_s : float
        Time from scan to scan, lately; NaN before the second.
    """

    order: BeamOrder = field(default_factory=lambda: BeamOrder())
    period_s: float = math.nan
    _last_ns: int | None = None

    def update(self, scan: LaserScan) -> None:
        """Take the stamp of the next scan."""
        last, self._last_ns = self._last_ns, scan.stamp_ns
        seconds = 0.0 if last is None else (scan.stamp_ns - last) * 1e-9
        if seconds > 0:
            before = seconds if math.isnan(self.period_s) else self.period_s
            self.period_s = before + 0.1 * (min(seconds, 2 * before) - before)

    def sweep_s(self, scan: LaserScan) -> float:
        """Presumed time of a scan: its field of view of a turn; NaN where it is not known."""
        return field_of_view_rad(scan.geometry.bearings) / math.tau * self.period_s

    def of(self, scan: LaserScan, beams: IntArray) -> FloatArray | None:
        """Times (K,) of beams (K,), relative to their mean, s; None where they are not known."""
        if not len(beams):
            return None
        times = scan.beam_times_s
        found = np.asarray(beams * (self.sweep_s(scan) / len(scan)) if times is None else times[beams])
        return None if math.isnan(found[0]) else found - found.mean()

    def is_informative(self, turned_rad: float) -> bool:
        """Whether a scan in which the robot turns so much is to be tried."""
        return abs(turned_rad) > _SMEAR_RAD and self.order.count < _ENOUGH

    def deskew_times(self, times_s: FloatArray | None) -> FloatArray | None:
        """The times (K,) by which to deskew a scan, in the order that is certain; None before, also if reported.

        Scans deskewed in the wrong order would build a map that they fit best.
        """
        swept = self.order.sweep_factor
        return None if times_s is None or not swept else math.copysign(1.0, swept) * times_s


@final
@dataclass(slots=True)
class BeamOrder:
    """Collects inlier ratios of scans of a turning robot.

    A scan is tried as if its beams had been measured at once, one after the other over a presumed time, and the other
    way round. The share that agrees falls with the square of how far a presumption is from what is true, and of three
    points on a parabola the top is known.
    """

    count: int = 0
    _sums: FloatArray = field(default_factory=lambda: np.zeros(2))
    _squares: float = 0.0

    def add(self, shares: FloatArray) -> None:
        """Take shares (3,): at once, in order, backward."""
        gains = shares[1:] - shares[0]
        self.count += 1
        self._sums = self._sums + gains
        self._squares += float(gains[0] - gains[1]) ** 2

    @property
    def sweep_factor(self) -> float:
        """Time that a scan takes, of the time presumed: positive in order, negative backward, 0 if not for certain."""
        forward, backward = self._sums.tolist()
        loss, contrast = -(forward + backward), forward - backward
        if self.count < _FEWEST or loss <= 0:
            return 0.0
        mean = contrast / self.count
        sigma = math.sqrt(max(self._squares / self.count - mean * mean, 1e-12) / self.count)
        share = contrast / (2 * loss)
        return share if abs(share) > _SWEEPS and abs(mean) > max(_GAIN, _SIGMAS * sigma) else 0.0
