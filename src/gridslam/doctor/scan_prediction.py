"""Predict the scan of a laser at another pose from one scan.

A surface seen from one place is seen from another at a bearing and range that follow from the motion between the two.
How far the measured ranges are from those is a ratio. No map is built, and neither a cell size nor a noise in metres is
assumed.
"""

from __future__ import annotations

import math
from typing import final

import numpy as np
from numpy.typing import NDArray

from gridslam.geometry.angles import wrap
from gridslam.geometry.se2 import adjoint
from gridslam.types import FloatArray, LaserScan

FEWEST_BEAMS = 10
"""A scan of fewer ranges predicts nothing."""

_MOST_BEAMS = 64  # of those predicted: more cost time and change no median
_MOST_SEEN = 180  # of those they are compared with, or up to twice as many
_LEAST_COMMON = 0.5  # of the beams: with fewer in view at both places nothing is known
_WIDEST_RAD = 0.1  # between neighbouring ranges that are interpolated, or
_WIDEST = 2.5  # times the usual gap between beams: what is in wider gaps is not known
_NEAREST = 1e-9
_COARSE_RAD: FloatArray = np.linspace(-0.1, 0.1, 5, dtype=np.float64)
_FINE_RAD: FloatArray = np.linspace(-0.025, 0.025, 5, dtype=np.float64)
"""Turns tried beside that of odometry, which errs by some hundredths of a radian: wheels slip in turns."""


@final
class PolarScan:
    """Ranges of a scan over their bearings, about the laser, by the axes of the base.

    Parameters
    ----------
    scan : LaserScan
        Its geometry is used.
    measured : (B,) bool
        Which of its ranges are distances; they are finite and positive.

    Attributes
    ----------
    ends : (K, 2) float64
        Ends of at most 64 of its beams, m.
    origin : (2,) float64, m
        The laser's place in the base frame.
    """

    __slots__ = ("_bearings", "_nearness", "ends", "origin")

    def __init__(self, scan: LaserScan, measured: NDArray[np.bool_]) -> None:
        """Order the beams by their bearings."""
        beams = np.flatnonzero(measured)
        beams = beams[:: max(len(beams) // _MOST_SEEN, 1)]
        ends = scan.geometry.directions[beams] * scan.ranges[beams, None]
        self.ends: FloatArray = ends[:: -(-len(ends) // _MOST_BEAMS) or 1]
        self.origin: FloatArray = scan.geometry.origin
        bearings = np.arctan2(ends[:, 1], ends[:, 0])
        order = np.argsort(bearings, kind="stable")
        around = np.concatenate([order[-1:], order, order[:1]])
        bearings = bearings[around]
        bearings[0] -= math.tau
        bearings[-1] += math.tau
        widths = np.diff(bearings)
        gaps = np.flatnonzero(widths > max(_WIDEST_RAD, _WIDEST * float(np.median(widths))))
        edges = np.concatenate([np.nextafter(bearings[gaps], np.inf), np.nextafter(bearings[gaps + 1], -np.inf)])
        places = np.tile(gaps + 1, 2)
        self._bearings: FloatArray = np.insert(bearings, places, edges)
        nearness = 1 / np.maximum(np.hypot(ends[:, 0], ends[:, 1])[around], _NEAREST)
        self._nearness: FloatArray = np.insert(nearness, places, np.nan)

    def nearness_at(self, bearings: FloatArray) -> FloatArray:
        """Inverse ranges at bearings (...,) in [-pi, pi); NaN between beams that are far apart.

        Between two beams the inverse range is interpolated, which is exact on a straight wall.
        """
        return np.interp(bearings, self._bearings, self._nearness)


def find_disagreement(first: PolarScan, second: PolarScan, motion: FloatArray) -> float:
    """Return how badly the second scan agrees with the first one, seen after a motion of the base.

    Parameters
    ----------
    first, second : PolarScan
        Each of at least `FEWEST_BEAMS` beams.
    motion : (3,) float64
        Pose of the base at the second scan seen from the first, m and rad. Turns that differ by up to 0.125 rad are
        tried, too.

    Returns
    -------
    float
        Median of the absolute logarithms of the ratio of predicted and measured range, at the best of all turns;
        infinite where less than half of the beams are in view of both.
    """
    predicted = _predict(first, second, motion)
    best = _COARSE_RAD[_medians(second, *predicted, _COARSE_RAD).argmin()]
    return float(_medians(second, *predicted, best + _FINE_RAD).min())


def log_ratios(first: PolarScan, second: PolarScan, motion: FloatArray) -> FloatArray:
    """Logarithms (K,) of the ratios of predicted and measured range, for the turn of the motion.

    Those of beams in view of both; below 0 where the second scan sees farther than the first one.
    """
    ranges, bearings = _predict(first, second, motion)
    ratios = np.log(ranges * second.nearness_at(bearings))
    return np.asarray(ratios[np.isfinite(ratios)])


def _predict(first: PolarScan, second: PolarScan, motion: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return ranges and bearings (K,) of the ends of a scan from the laser of the second one, by the base's motion."""
    turn = adjoint(motion * [0.0, 0.0, 1.0])[:2, :2]
    way = motion[:2] + turn @ second.origin - first.origin  # of the laser
    moved = (first.ends - way) @ turn
    return np.maximum(np.hypot(moved[:, 0], moved[:, 1]), _NEAREST), np.arctan2(moved[:, 1], moved[:, 0])


def _medians(scan: PolarScan, ranges: FloatArray, bearings: FloatArray, turns: FloatArray) -> FloatArray:
    """Return median disagreements (T,) of predicted ranges (K,) at bearings (K,), turned by -`turns` (T,)."""
    turned = wrap(bearings - turns[:, None])
    apart = np.abs(np.log(ranges * scan.nearness_at(turned)))
    apart.sort(axis=1)  # what is unknown comes last
    known = np.count_nonzero(np.isfinite(apart), axis=1)
    beams = len(bearings)
    median = apart[np.arange(len(turns)), np.minimum(known // 2, beams - 1)]
    return np.where(known >= max(FEWEST_BEAMS, _LEAST_COMMON * beams), median, np.inf)
