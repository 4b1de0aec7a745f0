"""The unit of the ranges: metres, or one in which laser and odometry measure different ways of the same motion."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final, final

import numpy as np
from numpy.typing import NDArray

from gridslam.doctor.scan_prediction import (
    FEWEST_BEAMS,
    PolarScan,
    disagreement_as_reported,
    disagreements,
    move_laser,
)
from gridslam.geometry.se2 import between
from gridslam.types import BeamStatus, FloatArray, LaserScan

UNITS: Final = {"feet": 1 / 0.3048, "inches": 1 / 0.0254, "centimetres": 100.0, "millimetres": 1000.0}
_SCALES: Final = np.array([0.0, 1.0, *UNITS.values()])
"""Ranges per metre of odometry that are compared: of a laser that stands still, in metres, and in other units."""
_OTHERS: Final = 2  # where these begin

_DISTANCES_M = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0)
"""Between the scans of a pair: the near ones suit small rooms, and the wide ones halls."""
_NEAR = 3  # of these distances: within a room
_MOST_TURNED_RAD = 0.5  # in the shortest distance
_PAIRS = 12  # of each distance
_TRIALS = 24  # with those that have nothing in common, as in doors and crowds
_MOST_PAIRS = 48  # of all distances
_MOST_TRIALS = 96
_EXPLAINED = 0.06  # disagreement: a pair that no scale explains better has nothing in common
_NOISE = 0.0015  # smaller disagreements are all the same, and
_UNLIKE = 0.25  # larger ones
_ALIKE = 0.25  # logarithm of the ratio of two disagreements: interpolation between beams averages noise
_CLEAR = 1.5  # and beyond which it counts no more: a single pair may be of another kind
_DEVIATIONS = 1.2
_EVIDENCE = 4.0
"""By which a unit must exceed each of the others: the sum, over the pairs, of the logarithm of the ratio of their
disagreements, and this sum in units of its root of squares. In healthy logs it is negative."""

_CERTAIN = 2.0  # times as much evidence, for metres or another unit: no more pairs are compared

_CHANGES = 0.05  # disagreement: the motion shows in the scan; along a bare corridor it does not
_STOPPED = 0.15  # of the change that the odometry predicts: noise
_MOSTLY = 0.9  # of the pairs
_FEWEST_PAIRS = 6

_ABSURD = 1e9  # in any unit
_FARTHEST_M = 1000.0  # beyond the reach of lasers on robots
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


def polar_scan(scan: LaserScan) -> PolarScan | None:
    """Return the measured ranges of a scan by their bearings; None if they are too few."""
    measured = measured_beams(scan)
    return PolarScan(scan, measured) if np.count_nonzero(measured) >= FEWEST_BEAMS else None


@final
@dataclass
class _Placed:
    """A scan, and the odometry where it was taken."""

    pose: FloatArray
    scan: LaserScan

    @cached_property
    def view(self) -> PolarScan | None:
        """The scan by its bearings; None if it has too few ranges."""
        return polar_scan(self.scan)


@final
@dataclass(slots=True)
class PairComparison:
    """Pairs of scans, compared by the odometry between them, for each unit that the ranges may have.

    At most 48 pairs are compared, each in some 0.3 ms, 12 of each of eight distances; another scan costs microseconds.
    """

    _references: list[_Placed | None] = field(default_factory=lambda: [None] * len(_DISTANCES_M))
    _trials: list[int] = field(default_factory=lambda: [0] * len(_DISTANCES_M))
    _counts: list[int] = field(default_factory=lambda: [0] * len(_DISTANCES_M))
    _pairs: list[FloatArray] = field(default_factory=list)
    _stopped: list[bool] = field(default_factory=list)
    _is_certain: bool = False

    @property
    def is_complete(self) -> bool:
        """Whether enough pairs have been compared, or tried; further scans take no part."""
        return self._is_certain or len(self._pairs) >= _MOST_PAIRS or sum(self._trials) >= _MOST_TRIALS

    def take(self, pose: FloatArray, scan: LaserScan) -> None:
        """Take the next scan of the laser, with the pose (3,) of the odometry."""
        if self.is_complete:
            return
        placed = _Placed(pose, scan)
        x, y, theta = pose.tolist()
        for k, distance_m in enumerate(_DISTANCES_M):
            if self._counts[k] >= _PAIRS or self._trials[k] >= _TRIALS:
                continue
            reference = self._references[k]
            if reference is not None:
                before = reference.pose.tolist()
                metres = math.dist((x, y), before[:2])
                turned = abs((theta - before[2] + math.pi) % math.tau - math.pi)
                if metres < distance_m and (k or turned < _MOST_TURNED_RAD):
                    continue
                if metres < 2 * distance_m:
                    self._compare(k, reference, placed, has_length=metres >= distance_m)
            self._references[k] = placed

    def _compare(self, k: int, first: _Placed, second: _Placed, *, has_length: bool) -> None:
        """Compare two scans for each unit, and whether the motion shows; a turn has no length, and so no unit."""
        self._trials[k] += has_length
        before = first.view
        after = second.view
        if before is None or after is None:
            return
        motion = move_laser(before, after, between(first.pose, second.pose))
        if has_length:
            found = disagreements(before, after, motion, _SCALES)
            if found.min() > _EXPLAINED:
                return
            self._counts[k] += 1
            self._pairs.append(found)
            if len(self._pairs) % _FEWEST_PAIRS == 0:
                self._is_certain = self._find_scale(_CERTAIN) is not None
        if k < _NEAR and len(self._stopped) < _MOST_PAIRS:
            predicted = disagreement_as_reported(before, before, motion)
            if _CHANGES < predicted < math.inf:
                unmoved = disagreement_as_reported(before, after, np.zeros(3))
                self._stopped.append(unmoved < _STOPPED * min(predicted, _UNLIKE))

    def find_unit(self) -> tuple[str, int] | None:
        """Return the unit, if it is surely another one than metres, and the number of pairs that were compared."""
        best = self._find_scale(1.0)
        return None if best is None or best < _OTHERS else (list(UNITS)[best - _OTHERS], len(self._pairs))

    def _find_scale(self, factor: float) -> int | None:
        """Return which of the scales predicts better than all others, with `factor` times the evidence needed."""
        if len(self._pairs) < _FEWEST_PAIRS:
            return None
        found = np.array(self._pairs)
        logs = np.log(np.clip(found, _NOISE, _UNLIKE))
        for k in range(1, len(_SCALES)):
            better = np.delete(logs - logs[:, k : k + 1], k, axis=1)
            better = np.sign(better) * np.clip(np.abs(better) - _ALIKE, 0, _CLEAR)
            better[np.isinf(found[:, k])] = 0
            total = better.sum(axis=0)
            spread = np.sqrt(np.square(better).sum(axis=0))
            if (total > factor * np.maximum(_EVIDENCE, _DEVIATIONS * spread)).all():
                return k
        return None

    def find_stop(self) -> int | None:
        """Number of pairs in nearly all of which the laser saw none of the motion of the odometry, if it is so."""
        stopped = self._stopped
        return len(stopped) if len(stopped) >= _FEWEST_PAIRS and sum(stopped) >= _MOSTLY * len(stopped) else None


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
            return f"most ranges are beyond {_FARTHEST_M:.0f}, which no laser of a robot measures in metres"
        if self._whole == self._readings and len(self._distinct) >= _DISTINCT:
            return "all ranges are whole numbers, and no laser rounds to metres"
        return None
