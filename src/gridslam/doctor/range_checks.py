"""Ranges that no map can be made of: too large for metres, of a frozen laser, or random."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import final

import numpy as np
from numpy.typing import NDArray

from gridslam.doctor.finding import Finding, Severity, percent
from gridslam.doctor.range_units import RangeSizes, measured_beams
from gridslam.io.measurement import Measurement
from gridslam.types import BeamStatus, FloatArray, LaserScan

_FROZEN_M = 1.0  # of odometry: a laser with noise never sees the same so long
_FROZEN_RAD = 0.5
_FROZEN_SHARE = 0.1  # of the way: from here on the map is unusable

_SAMPLED = 25  # scans whose ranges are looked at one by one; and then
_RARE = 32  # one of as many
_MOST_SCANS = 50
_FEWEST_SCANS = 12
_FEWEST_BEAMS = 30
_SPREAD = 0.1  # of the logarithms of unrelated ranges: those in a round room are alike
_UNRELATED = 0.8  # of that spread: random ranges have 1, and walls some hundredths


@final
@dataclass(slots=True)
class _FrozenScans:
    """Runs of scans that are identical to the last bit over 1 m or 0.5 rad of odometry and more.

    `way` and `frozen` are the odometry's metres and radians in units of these, of all scans and of such runs.
    """

    way: float = 0.0
    frozen: float = 0.0
    _ranges: bytes = b""
    _last: FloatArray | None = None
    _run: float = 0.0

    def take(self, pose: FloatArray, scan: LaserScan) -> None:
        """Take the next scan of the laser, with the pose (3,) of the odometry."""
        before, self._last = self._last, pose
        same = (ranges := scan.ranges.tobytes()) == self._ranges
        self._ranges = ranges
        if before is None:
            return
        x, y, theta = (pose - before).tolist()
        moved = math.hypot(x, y) / _FROZEN_M + abs(math.remainder(theta, math.tau)) / _FROZEN_RAD
        self.way += moved
        was_frozen = self._run >= 1
        self._run = self._run + moved if same else 0.0
        if self._run >= 1 and np.count_nonzero(scan.status == BeamStatus.HIT) >= _FEWEST_BEAMS:
            self.frozen += moved if was_frozen else self._run

    def skip(self) -> None:
        """Take a scan without odometry: the motion since the last one is not known."""
        self._last = None
        self._run = 0.0

    @property
    def share(self) -> float:
        """Share of the odometry's way in which the scans are frozen."""
        return self.frozen / max(self.way, 1.0)


@final
@dataclass(slots=True)
class _Relations:
    """How far ranges differ from their neighbours, and from those of the same beam in the scan before."""

    _medians: list[tuple[float, float, float]] = field(default_factory=list)

    def take(self, before: LaserScan, scan: LaserScan, measured: NDArray[np.bool_]) -> None:
        """Take two scans that follow each other, and which beams (B,) the second measured."""
        if len(before) != len(scan) or len(self._medians) >= _MOST_SCANS:
            return
        both = measured & measured_beams(before)
        if np.count_nonzero(both) < _FEWEST_BEAMS:
            return
        now = np.log(scan.ranges[both])
        count = len(now)
        unrelated = np.abs(np.concatenate([now - np.roll(now, count // 3), now - np.roll(now, count // 5)]))
        near = np.abs(np.diff(now))
        then = np.abs(now - np.log(before.ranges[both]))
        self._medians.append((float(np.median(unrelated)), float(np.median(near)), float(np.median(then))))

    def find_random(self) -> tuple[float, float] | None:
        """Spreads of neighbours and of successive ranges as shares of that of unrelated ones, if these are no less."""
        if len(self._medians) < _FEWEST_SCANS:
            return None
        unrelated, near, then = np.median(np.array(self._medians), axis=0).tolist()
        if unrelated < _SPREAD or min(near, then) < _UNRELATED * unrelated:
            return None
        return near / unrelated, then / unrelated


@final
@dataclass(slots=True)
class RangeExaminer:
    """The ranges of one laser, by themselves and against the odometry: range_units, laser_frozen, random_ranges."""

    _sizes: RangeSizes = field(default_factory=RangeSizes)
    _frozen: _FrozenScans = field(default_factory=_FrozenScans)
    _relations: _Relations = field(default_factory=_Relations)
    _scans: int = 0
    _previous: LaserScan | None = None

    def take(self, measurement: Measurement) -> None:
        """Take the next scan of the laser."""
        odometry, scan = measurement
        if self._previous is not None and (self._scans <= _SAMPLED or self._scans % _RARE == 0):
            measured = measured_beams(scan)
            self._relations.take(self._previous, scan, measured)
            self._sizes.take(scan.ranges[measured])
        self._previous = scan
        self._scans += 1
        if odometry is None:
            self._frozen.skip()
        else:
            self._frozen.take(odometry.pose, scan)

    def findings(self, sensor: str) -> Iterator[Finding]:
        """Yield the finding on the ranges of the laser of that name: one at the most, as the others follow from it."""
        found = self._random(sensor) or self._laser_frozen(sensor) or self._units(sensor)
        if found is not None:
            yield found

    def _random(self, sensor: str) -> Finding | None:
        relations = self._relations.find_random()
        if relations is None:
            return None
        near, then = relations
        return Finding(
            "random_ranges",
            Severity.ERROR,
            f"The ranges are random: those of neighbouring beams differ {near:.2f} times as much as those of any two "
            f"beams, and those of successive scans {then:.2f} times; walls make some hundredths.",
            min(near, then),
            "1",
            "Look at the driver and the cable of the laser; no map can be made of such scans.",
            sensor,
        )

    def _laser_frozen(self, sensor: str) -> Finding | None:
        share = self._frozen.share
        if not share:
            return None
        return Finding(
            "laser_frozen",
            Severity.ERROR if share > _FROZEN_SHARE else Severity.WARNING,
            f"The laser is frozen: its scans are identical over {percent(share)} of the odometry's way and turns.",
            share,
            "share",
            "Look for what stops the laser or repeats its scans; there is nothing to map in between.",
            sensor,
        )

    def _units(self, sensor: str) -> Finding | None:
        odd = self._sizes.describe()
        if odd is None:
            return None
        return Finding(
            "range_units",
            Severity.ERROR,
            f"The ranges are not in metres, but in centimetres, millimetres or another unit: {odd}.",
            None,
            "",
            "Convert the ranges and their limits to metres where they are recorded; they are never converted here.",
            sensor,
        )
