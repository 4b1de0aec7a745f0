"""Which beams measured a distance, and range values that cannot be metres."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final, final

import numpy as np
from numpy.typing import NDArray

from gridslam.types import BeamStatus, FloatArray, LaserScan

UNITS: Final = {"feet": 1 / 0.3048, "inches": 1 / 0.0254, "centimetres": 100.0, "millimetres": 1000.0}
"""Of a metre."""

_ABSURD = 1e9  # in any unit
_FARTHEST_M = 200.0  # the median of no scan of a robot is as far
_DISTINCT = 50  # whole numbers: fewer may be chance, or chosen by hand
_FEWEST_READINGS = 1000
_MANY_BEYOND = 0.25  # of the beams
_AT_GREATEST = 0.99
_MANY_AT_GREATEST = 0.2  # of the ranges of a scan: a wall across the view has a tenth so near its greatest distance
_CODES = 1.2  # ratio of the quartiles of readings beyond the limit: codes for "no return" stand close together


def measured_beams(scan: LaserScan) -> NDArray[np.bool_]:
    """Return which beams (B,) measured a distance: hits, and readings beyond the stated limit that vary as walls do.

    A limit in metres over ranges in millimetres turns them all into beams that hit nothing. And beams that hit nothing
    may be reported as hits at the greatest range: where many stand together there, they are left out.
    """
    ranges = scan.ranges
    plausible = (ranges > 0) & (ranges < _ABSURD)
    measured: NDArray[np.bool_] = (scan.status == BeamStatus.HIT) & plausible
    if np.count_nonzero(measured) < (1 - _MANY_BEYOND) * len(scan):
        beyond = _without_codes(ranges, (scan.status == BeamStatus.NO_RETURN) & plausible)
        if np.count_nonzero(beyond) > _MANY_BEYOND * len(scan):
            low, high = np.quantile(ranges[beyond], [0.25, 0.75])
            measured = measured | beyond if high > _CODES * low else measured
    return _without_codes(ranges, measured)


def _without_codes(ranges: FloatArray, some: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Some of the beams (B,), but for those at the greatest of their ranges, if these are many."""
    if not some.any():
        return some
    greatest = some & (ranges >= _AT_GREATEST * ranges[some].max())
    return some & ~greatest if np.count_nonzero(greatest) > _MANY_AT_GREATEST * np.count_nonzero(some) else some


@final
@dataclass(slots=True)
class RangeSizes:
    """Range values that cannot be metres, independent of the odometry: beyond every laser, or all integers."""

    _readings: int = 0
    _far: int = 0
    _whole: int = 0
    _distinct: set[float] = field(default_factory=set)

    def take(self, ranges: FloatArray) -> None:
        """Take the measured ranges (K,) of a scan."""
        whole = ranges == np.rint(ranges)
        self._readings += len(ranges)
        self._far += int(np.count_nonzero(ranges > _FARTHEST_M))
        self._whole += int(np.count_nonzero(whole))
        if len(self._distinct) < _DISTINCT:
            self._distinct.update(ranges[whole].tolist())

    def describe(self) -> str | None:
        """Describe the fault of the range values; None if they may be in metres."""
        if self._readings < _FEWEST_READINGS:
            return None
        if 2 * self._far > self._readings:
            return f"most are beyond {_FARTHEST_M:.0f}, farther than lasers of robots measure"
        if self._whole == self._readings and len(self._distinct) >= _DISTINCT:
            return "all are whole numbers, and no laser rounds to metres"
        return None
