"""The unit of the ranges: metres, or one in which laser and odometry measure different ways of the same motion."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final, TypeAlias, final

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

__all__ = ["UNITS", "PairComparison", "RangeSizes", "measured_beams"]

UNITS: Final = {"feet": 1 / 0.3048, "inches": 1 / 0.0254, "centimetres": 100.0, "millimetres": 1000.0}
_SCALES: Final = np.array([0.0, 1.0, *UNITS.values()])
"""Ranges per metre of odometry that are compared: of a laser that stands still, in metres, and in other units."""

_DISTANCES_M = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0)
"""Between the scans of a pair: the near ones suit small rooms, and the wide ones halls."""
_NEAR = 3  # of these distances: within a room
_MOST_TURNED_RAD = 0.5  # in the shortest distance
_PAIRS = 12  # of each distance
_TRIALS = 36  # with those that have nothing in common, as in doors and crowds
_EXPLAINED = 0.06  # disagreement: a pair that no scale explains better has nothing in common
_NOISE = 0.0015  # smaller disagreements are all the same, and
_UNLIKE = 0.25  # larger ones
_ALIKE = 0.25  # logarithm of the ratio of two disagreements: interpolation between beams averages noise
_DEVIATIONS = 1.2
_EVIDENCE = 4.0
"""By which a unit must exceed each of the others: the sum, over the pairs, of the logarithm of the ratio of their
disagreements, and this sum in units of its root of squares. In healthy logs it is negative."""

_CHANGES = 0.05  # disagreement: the motion shows in the scan; along a bare corridor it does not
_STOPPED = 0.15  # of the change that the odometry predicts: noise
_MOSTLY = 0.9  # of the pairs
_FEWEST_PAIRS = 6
_MOST_STOPS = 200

_FARTHEST_M = 1000.0  # beyond the reach of lasers on robots
_DISTINCT = 50  # whole numbers: fewer may be chance, or chosen by hand
_FEWEST_READINGS = 1000
_MANY_BEYOND = 0.25  # of the beams
_CODES = 1.2  # ratio of the quartiles of readings beyond the limit: codes for "no return" stand close together

_Placed: TypeAlias = tuple[FloatArray, LaserScan]
"""A scan, with the pose (3,) of the odometry."""


def measured_beams(scan: LaserScan) -> NDArray[np.bool_]:
    """Which beams (B,) measured a distance: the hits, and readings beyond the stated limit that vary as walls do.

    A limit in metres over ranges in millimetres turns them all into beams that hit nothing.
    """
    hits: NDArray[np.bool_] = (scan.status == BeamStatus.HIT) & (scan.ranges > 0)
    if np.count_nonzero(hits) >= (1 - _MANY_BEYOND) * len(scan):
        return hits
    beyond = (scan.status == BeamStatus.NO_RETURN) & np.isfinite(scan.ranges)
    if beyond.any():
        beyond &= scan.ranges < scan.ranges[beyond].max()  # the code for "no return" is the greatest
    if np.count_nonzero(beyond) <= _MANY_BEYOND * len(scan):
        return hits
    low, high = np.quantile(scan.ranges[beyond], [0.25, 0.75])
    return hits | beyond if high > _CODES * low else hits


def _views(first: _Placed, second: _Placed) -> tuple[PolarScan, PolarScan] | None:
    """Two scans by their bearings; None if one of them has too few ranges."""
    beams = [measured_beams(scan) for _, scan in (first, second)]
    if min(np.count_nonzero(some) for some in beams) < FEWEST_BEAMS:
        return None
    return PolarScan(first[1], beams[0]), PolarScan(second[1], beams[1])


@final
@dataclass(slots=True)
class PairComparison:
    """Pairs of scans, compared by what odometry moved between them, for each unit that the ranges may have.

    Of each of eight distances 12 pairs are compared, each in some 0.4 ms; another scan costs some microseconds.
    """

    _references: list[_Placed | None] = field(default_factory=lambda: [None] * len(_DISTANCES_M))
    _trials: list[int] = field(default_factory=lambda: [0] * len(_DISTANCES_M))
    _counts: list[int] = field(default_factory=lambda: [0] * len(_DISTANCES_M))
    _pairs: list[FloatArray] = field(default_factory=list)
    _stopped: list[bool] = field(default_factory=list)

    @property
    def is_complete(self) -> bool:
        """Whether enough pairs have been compared, or tried."""
        return sum(self._counts) >= _NEAR * _PAIRS or sum(self._trials) >= _NEAR * _TRIALS

    def take(self, pose: FloatArray, scan: LaserScan) -> None:
        """Take the next scan of the laser, with the pose (3,) of the odometry."""
        x, y, theta = pose.tolist()
        for k, distance_m in enumerate(_DISTANCES_M):
            if self._counts[k] >= _PAIRS or self._trials[k] >= _TRIALS:
                continue
            reference = self._references[k]
            if reference is not None:
                before = reference[0].tolist()
                metres = math.dist((x, y), before[:2])
                turned = abs((theta - before[2] + math.pi) % math.tau - math.pi)
                if metres < distance_m and (k or turned < _MOST_TURNED_RAD):
                    continue
                if distance_m > metres:
                    self._compare_turned(reference, (pose, scan))
                elif metres < 2 * distance_m:
                    self._compare(k, reference, (pose, scan))
            self._references[k] = (pose, scan)

    def _compare(self, k: int, first: _Placed, second: _Placed) -> None:
        """Compare two scans for each unit."""
        self._trials[k] += 1
        views = _views(first, second)
        if views is None:
            return
        motion = move_laser(*views, between(first[0], second[0]))
        found = disagreements(*views, motion, _SCALES)
        if found.min() <= _EXPLAINED:
            self._counts[k] += 1
            self._pairs.append(found)
            if k < _NEAR:
                self._note_stop(views, motion)

    def _compare_turned(self, first: _Placed, second: _Placed) -> None:
        """Look whether a turn shows in the second scan; it has no length, and so no unit."""
        views = _views(first, second) if len(self._stopped) < _MOST_STOPS else None
        if views is not None:
            self._note_stop(views, move_laser(*views, between(first[0], second[0])))

    def _note_stop(self, views: tuple[PolarScan, PolarScan], motion: FloatArray) -> None:
        predicted = disagreement_as_reported(views[0], views[0], motion)
        if _CHANGES < predicted < math.inf:
            unmoved = disagreement_as_reported(*views, np.zeros(3))
            self._stopped.append(unmoved < _STOPPED * min(predicted, _UNLIKE))

    def find_unit(self) -> tuple[str, int] | None:
        """The unit, if it is surely another one than metres, and the number of pairs that were compared."""
        if len(self._pairs) < _FEWEST_PAIRS:
            return None
        found = np.array(self._pairs)
        logs = np.log(np.clip(found, _NOISE, _UNLIKE))
        for k, name in enumerate(UNITS, start=len(_SCALES) - len(UNITS)):
            better = logs - logs[:, k : k + 1]
            better = np.sign(better) * np.maximum(np.abs(better) - _ALIKE, 0)
            better[np.isinf(found[:, k])] = 0
            better = np.delete(better, k, axis=1)
            total = better.sum(axis=0)
            spread = np.sqrt(np.square(better).sum(axis=0))
            if (total > np.maximum(_EVIDENCE, _DEVIATIONS * spread)).all():
                return name, len(found)
        return None

    def find_stop(self) -> int | None:
        """Number of pairs in nearly all of which the laser saw none of the motion of the odometry, if it is so."""
        stopped = self._stopped
        return len(stopped) if len(stopped) >= _FEWEST_PAIRS and sum(stopped) >= _MOSTLY * len(stopped) else None


@final
@dataclass(slots=True)
class RangeSizes:
    """Sizes of ranges that are not in metres whatever the odometry: far beyond every laser, or all whole numbers."""

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
        """What is wrong with the sizes; None if they may be in metres."""
        if self._readings < _FEWEST_READINGS:
            return None
        if 2 * self._far > self._readings:
            return f"most ranges are beyond {_FARTHEST_M:.0f}, which no laser of a robot measures in metres"
        if self._whole == self._readings and len(self._distinct) >= _DISTINCT:
            return "all ranges are whole numbers, and no laser rounds to metres"
        return None
