"""A scan with its pose, compared with earlier ones."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final, final

import numpy as np
from numpy.typing import NDArray

from gridslam.doctor.range_units import measured_beams
from gridslam.doctor.scan_prediction import FEWEST_BEAMS, PolarScan, find_disagreement, log_ratios
from gridslam.geometry.se2 import between
from gridslam.types import BeamStatus, FloatArray, LaserScan

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
@dataclass(frozen=True, eq=False)
class View:
    """A scan with the pose (3,) of the odometry; its ranges are ordered by bearing once they are needed."""

    pose: FloatArray
    scan: LaserScan

    @cached_property
    def measured(self) -> FloatArray:
        """The ranges (B,), 0 where nothing was hit."""
        return np.where(self.scan.status == _HIT, self.scan.ranges, 0.0)

    @cached_property
    def polar(self) -> PolarScan | None:
        """The measured ranges by their bearings; None if they are too few."""
        measured = measured_beams(self.scan)
        return PolarScan(self.scan, measured) if np.count_nonzero(measured) >= FEWEST_BEAMS else None

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

    def differs_from(self, before: View) -> float:
        """How badly the scan agrees with one from before; NaN or infinite where they have too little in common."""
        if self.polar is None or before.polar is None:
            return math.nan
        return find_disagreement(before.polar, self.polar, between(before.pose, self.pose))

    def is_both_sides_of(self, before: View) -> bool:
        """Return whether many beams end nearer, and many farther than by the view from before.

        Who passes a door sees farther in most directions, or nearer.
        """
        if self.polar is None or before.polar is None:
            return False
        ratios = log_ratios(before.polar, self.polar, between(before.pose, self.pose))
        low, high = np.quantile(ratios, [_MANY, 1 - _MANY]) if len(ratios) else (0.0, 0.0)
        return bool(low < -_SIDE and high > _SIDE)


def find_similar(scans: Sequence[LaserScan]) -> list[LaserScan | None]:
    """Return for each of consecutive scans the one before it, None where that one is not similar.

    Similar are scans of which none is covered beside the other, and whose ranges are not changed beam by beam: they are
    compared all at once. Where the number of beams varies none is called similar.
    """
    if len({len(scan) for scan in scans}) > 1:
        return [None] * len(scans)
    measured = np.where(np.array([scan.status for scan in scans]) == _HIT, [scan.ranges for scan in scans], 0.0)
    differ = are_covered(measured[:-1], measured[1:]) | are_changed(measured[:-1], measured[1:])
    return [None, *(None if other else before for before, other in zip(scans[:-1], differ.tolist(), strict=True))]


def are_covered(was: FloatArray, now: FloatArray) -> NDArray[np.bool_]:
    """Return whether ranges (..., B) show hardly anything beside those before: so does a laser held to the floor."""
    return np.asarray((now > _COVER_M).sum(axis=-1) < _BLIND * (was > _COVER_M).sum(axis=-1))


def are_changed(was: FloatArray, now: FloatArray) -> NDArray[np.bool_]:
    """Return whether more than half of ranges (..., B) are others than before; people who pass change fewer."""
    return np.asarray((np.abs(now - was) > _CHANGED_M + _CHANGED * was).sum(axis=-1) > _MOST_CHANGED * now.shape[-1])
