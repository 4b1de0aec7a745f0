"""A scan with its pose, compared with earlier ones."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property
from typing import Final, final

import numpy as np
from numpy.typing import NDArray

from gridslam.doctor.range_units import polar_scan
from gridslam.doctor.scan_prediction import PolarScan, find_disagreement, log_ratios, move_laser
from gridslam.geometry.se2 import between
from gridslam.types import BeamStatus, FloatArray, IntArray, LaserScan

OTHER: Final = 0.2
"""Disagreement (`View.differs_from`) from which on two scans show different places; on real logs it is a hundredth to a
tenth."""
SAME: Final = 0.1
"""Disagreement up to which two scans show one place."""

_HIT = int(BeamStatus.HIT)  # an enumeration takes longer to compare with an array than the array
_CHANGED_M = 0.1  # change of a range above noise, and
_CHANGED = 0.02  # of the range
_COVER_M = 0.3  # hands and arms are nearer while the robot is carried
_BLIND = 0.25  # of the beams that saw something before
_MOST_CHANGED = 0.5  # of these ranges: where fewer change no scan is predicted
_MANY = 0.2  # of the beams
_SIDE = 0.05  # of the logarithms: that much nearer, or farther


@final
class View:
    """A scan with the pose (3,) of the odometry; its ranges are ordered by bearing once they are needed."""

    def __init__(self, pose: FloatArray, scan: LaserScan) -> None:
        """Keep both as they are."""
        self.pose = pose
        self.scan = scan

    @cached_property
    def measured(self) -> FloatArray:
        """The ranges (B,), 0 where nothing was hit."""
        return _measured(self.scan.ranges, self.scan.status)

    @cached_property
    def polar(self) -> PolarScan | None:
        """The measured ranges by their bearings; None if they are too few."""
        return polar_scan(self.scan)

    def is_blind_beside(self, before: View) -> bool:
        """Whether hardly anything is seen, beside before: the laser is covered, or held to floor or ceiling."""
        return _count_seen(self.measured) < _BLIND * _count_seen(before.measured)

    def is_changed_from(self, before: View) -> bool:
        """Return whether more than half of the ranges are others than before, beam by beam and by the turn of both."""
        if len(self.scan) != len(before.scan) or len(self.scan) < 2:
            return True
        return bool(are_changed(before.measured, self.measured)) and self._is_changed_by_more_than_turn(before)

    def _is_changed_by_more_than_turn(self, before: View) -> bool:
        """Compare each beam with the one that looked that way before the robot turned, of beams at equal steps."""
        (x, y), (next_x, next_y) = self.scan.geometry.directions[:2].tolist()
        step = math.atan2(x * next_y - y * next_x, x * next_x + y * next_y)
        turn = math.remainder(float(self.pose[2] - before.pose[2]), math.tau)
        beams = len(self.scan)
        shift = round(turn / step) if abs(turn) < abs(step) * beams else 0
        was = before.measured[max(shift, 0) : beams + min(shift, 0)]
        return bool(are_changed(was, self.measured[max(-shift, 0) : beams - max(shift, 0)]))

    def differs_from(self, before: PolarScan, pose: FloatArray) -> float:
        """How badly the scan agrees with one from before; NaN or infinite where they have too little in common."""
        view = self.polar
        if view is None:
            return math.nan
        return find_disagreement(before, view, move_laser(before, view, between(pose, self.pose)))

    def is_both_sides_of(self, before: PolarScan, pose: FloatArray) -> bool:
        """Return whether many beams end nearer, and many farther than by the view from before.

        Who passes a door sees farther in most directions, or nearer.
        """
        view = self.polar
        if view is None:
            return False
        ratios = log_ratios(before, view, move_laser(before, view, between(pose, self.pose)))
        low, high = np.quantile(ratios, [_MANY, 1 - _MANY]) if len(ratios) else (0.0, 0.0)
        return bool(low < -_SIDE and high > _SIDE)


def find_similar(scans: Sequence[LaserScan]) -> list[LaserScan | None]:
    """Return for each of consecutive scans the one before it, if both are similar without regard to the odometry; else None.

    Similar is what is neither blind beside the other nor changed from it. Many scans of one laser are compared at once.
    """
    beams = {len(scan) for scan in scans}
    if len(beams) > 1 or min(beams) < 2:
        return [None] * len(scans)
    measured = _measured(np.array([scan.ranges for scan in scans]), np.array([scan.status for scan in scans]))
    seen = _count_seen(measured)
    similar = (seen[1:] >= _BLIND * seen[:-1]) & ~are_changed(measured[:-1], measured[1:])
    return [None, *(before if is_similar else None for before, is_similar in zip(scans, similar.tolist()))]


def _measured(ranges: FloatArray, status: NDArray[np.uint8]) -> FloatArray:
    """Return ranges (..., B), 0 where nothing was hit."""
    return np.where(status == _HIT, ranges, 0.0)


def _count_seen(measured: FloatArray) -> IntArray:
    """Return how many of ranges (..., B) are beyond what covers a laser."""
    return (measured > _COVER_M).sum(axis=-1)


def are_changed(was: FloatArray, now: FloatArray) -> NDArray[np.bool_]:
    """Return whether more than half of ranges (..., B) are others than before; people who pass change fewer."""
    changed = np.abs(now - was) > _CHANGED_M + _CHANGED * was
    return changed.sum(axis=-1) > _MOST_CHANGED * now.shape[-1]
