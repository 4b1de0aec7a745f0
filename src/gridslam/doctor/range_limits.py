"""Range limits that lie: "no return" that is reported as a range."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple, final

import numpy as np

from gridslam.doctor.finding import Finding, Severity, percent
from gridslam.types import BeamStatus, IntArray, LaserScan

_BIN_M = 0.01
_BINS = 20_000
_SECTORS = 16
_USED_M = 30.0  # the configuration's range_max_m: farther readings are neither matched nor mapped

_LEAST = 100  # readings: fewer at one value may be chance
_LEAST_SHARE = 1e-3  # of all hits: fewer harm nobody
_STEEP = 10.0  # times as many as any of the readings about it: surfaces fill ranges evenly
_BEYOND = 0.1  # of the readings there: what is farther is then no wall that is seen farther away
_WIDE = 0.5  # share of the field of view: no wall is equally far in so many directions, from several places
_SPOILING = 0.05  # share of hits: from one false end in twenty on, arcs remain where robots pass once

_MARGIN_M = 0.05  # below a pile: its readings jitter


class _RangePeak(NamedTuple):
    """Where readings pile up: the value, how many, and their share of the hits."""

    value_m: float
    readings: int
    share: float


@final
@dataclass(slots=True)
class RangeCounts:
    """How often one laser reported which range, by sector of its field of view: finds range_limits."""

    range_min_m: float = 0.0
    range_max_m: float = math.inf
    _hits: IntArray = field(default_factory=lambda: np.zeros((_BINS + 1, _SECTORS), np.int64))

    def take(self, scan: LaserScan) -> None:
        """Take the ranges of the next scan."""
        self.range_min_m = scan.range_min_m
        self.range_max_m = scan.range_max_m
        hits = (scan.status == BeamStatus.HIT).nonzero()[0]
        bins = (np.minimum(scan.ranges[hits], _BINS * _BIN_M) / _BIN_M + 0.5).astype(np.int64)
        np.add.at(self._hits, (bins, hits * _SECTORS // max(len(scan), 1)), 1)

    def find_peak(self) -> _RangePeak | None:
        """Return the value near the far end at which hits pile up as walls never do, if there is one."""
        by_bin = self._hits.sum(axis=1)
        total = int(by_bin.sum())
        if total < _LEAST:
            return None
        farther = total - np.cumsum(by_bin)
        often = (by_bin >= max(_LEAST, _LEAST_SHARE * total)) & (farther <= _BEYOND * by_bin)
        for place in np.flatnonzero(often[:_BINS]):  # the last bin is of no range: all that is farther
            count = int(by_bin[max(place - 1, 0) : place + 2].sum())
            about = by_bin[max(place - 100, 0) : max(place - 2, 0)]
            steep = count > _STEEP * 3 * (float(about.max()) if len(about) else 0.0)
            seen = np.count_nonzero(self._hits[max(place - 1, 0) : place + 2].sum(axis=0))
            if steep and seen >= _WIDE * _SECTORS:
                return _RangePeak(float(place) * _BIN_M, count, count / total)
        return None

    def false_hits_m(self) -> float | None:
        """Range from which on hits are beams without return, if there are so many that the map becomes unusable."""
        peak = self.find_peak()
        if peak is None or peak.value_m >= _USED_M or peak.share <= _SPOILING:
            return None
        return peak.value_m - _MARGIN_M

    def findings(self, sensor: str) -> Iterator[Finding]:
        """Report where the true limits of the laser of that name differ from the declared ones."""
        peak = self.find_peak()
        if peak is not None:
            yield self._range_peak(sensor, peak)

    def _range_peak(self, sensor: str, peak: _RangePeak) -> Finding:
        limited = math.isfinite(self.range_max_m)
        stated = f"{self.range_max_m:g} m" if limited else "unlimited"
        message = (
            f"{peak.readings} readings ({percent(peak.share)} of the hits) are {peak.value_m:.2f} m and next to none "
            f"is farther, while the range limit is {stated}: beams that hit nothing are reported as walls"
        )
        if peak.value_m >= _USED_M:
            message += f"; harmless, for readings from {_USED_M:g} m on are not used"
            severity = Severity.INFO
            remedy = f"Leave range_max_m below {peak.value_m - _MARGIN_M:.2f} m."
        else:
            severity = Severity.ERROR if peak.share > _SPOILING else Severity.WARNING
            remedy = f"Map with --set range_max_m={peak.value_m - _MARGIN_M:.2f}, or let the driver report inf."
        return Finding(
            "range_limits",
            severity,
            message + ".",
            self.range_max_m / peak.value_m if limited else None,
            "m/m",
            remedy,
            sensor,
        )
