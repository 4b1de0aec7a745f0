"""Beam times of a laser, in the order that fits the map best."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import final

import numpy as np

from gridslam.doctor.beams import field_of_view_rad
from gridslam.matching.beam_order import MIN_TURN_RAD, BeamOrder
from gridslam.types import FloatArray, IntArray, LaserScan

__all__ = ["BeamTimes"]

_MAX_SCANS = 300
"""Informative scans that are used: more cost time and change nothing."""


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

    order: BeamOrder = field(default_factory=BeamOrder)
    period_s: float = math.nan
    _last_ns: int | None = None

    def update(self, scan: LaserScan) -> None:
        """Take the stamp of the next scan."""
        seconds = 0.0 if self._last_ns is None else (scan.stamp_ns - self._last_ns) * 1e-9
        self._last_ns = scan.stamp_ns
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
        """Whether a scan in which the robot turns so much is to be tried in each order."""
        return abs(turned_rad) > MIN_TURN_RAD and self.order.scans < _MAX_SCANS

    def deskew_times(self, times_s: FloatArray | None) -> FloatArray | None:
        """The times (K,) by which to deskew a scan, in the order that is certain; None before, also if reported.

        Scans deskewed in the wrong order would build a map that they fit best.
        """
        swept = self.order.sweep_factor
        return None if times_s is None or not swept else math.copysign(1.0, swept) * times_s
