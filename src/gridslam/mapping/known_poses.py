"""Where the robot was when a scan was taken, by a trajectory that is known."""

from __future__ import annotations

from collections import Counter
from enum import Enum
from typing import Final, final

import numpy as np

from gridslam.errors import ArgumentError
from gridslam.geometry.angles import wrap
from gridslam.geometry.se2 import between, log
from gridslam.types import Beams, FloatArray, Trajectory

_EXACT_NS: Final = 1_000_000
"""A pose stamped so near is the scan's own: programs round stamps."""


class NoPoseReason(Enum):
    """Why it is not known where a scan was taken."""

    OUTSIDE = "outside the trajectory"
    GAP = "in a gap of the trajectory"


@final
class KnownPoses:
    """A trajectory, asked for the robot's pose at the stamps of scans: interpolated, never extrapolated.

    Parameters
    ----------
    trajectory : Trajectory
        Poses of the robot's base in the map frame, in any order of stamps.
    max_gap_s : float, s, > 0
        Between poses farther apart in time than this nothing is interpolated.

    Raises
    ------
    ArgumentError
        There is no pose, or the gap is not positive and finite.
    """

    def __init__(self, trajectory: Trajectory, max_gap_s: float = 1.0) -> None:
        if not len(trajectory):
            raise ArgumentError("trajectory", "at least one pose", "none")
        if not 0 < max_gap_s < np.inf:
            raise ArgumentError("max_gap_s", "a finite time above 0 s", max_gap_s)
        order = np.argsort(trajectory.stamps_ns, kind="stable")
        self._stamps = trajectory.stamps_ns[order]
        self._poses = trajectory.poses[order]
        self._passed_ns = (self._stamps - self._stamps[0]).astype(np.float64)
        self._coordinates = *self._poses[:, :2].T.copy(), np.unwrap(self._poses[:, 2])
        self._max_gap_ns = max_gap_s * 1e9
        self._asked = Counter[int]()

    @property
    def span_ns(self) -> tuple[int, int]:
        """First and last stamp."""
        return int(self._stamps[0]), int(self._stamps[-1])

    def at(self, stamp_ns: int) -> FloatArray | NoPoseReason:
        """Pose (3,) at a scan's stamp: x and y linear between the neighbours in time, theta along the shorter arc.

        Where several poses have just this stamp, as where several scans had it, they are given one after the other.
        """
        low = int(self._stamps.searchsorted(stamp_ns))
        high = int(self._stamps.searchsorted(stamp_ns, "right"))
        if low < high:
            self._asked[stamp_ns] += 1
            return np.array(self._poses[min(low + self._asked[stamp_ns], high) - 1])
        passed = self._stamps[max(low - 1, 0) : low + 1] - stamp_ns  # of the poses before and after
        if abs(passed).min() > _EXACT_NS:
            if len(passed) == 1:
                return NoPoseReason.OUTSIDE
            if passed[1] - passed[0] > self._max_gap_ns:
                return NoPoseReason.GAP
        return self._interpolate(stamp_ns)

    def deskew(self, beams: Beams) -> Beams:
        """Undo the motion of the robot during a scan by the trajectory; unchanged if there are no beam times."""
        times = beams.scan.beam_times_s
        if times is None or not len(times):
            return beams
        ends = beams.scan.stamp_ns + np.rint(1e9 * np.array([times.min(), times.max()])).astype(np.int64)
        start, end = np.clip(ends, *self.span_ns).tolist()
        if end - start < _EXACT_NS:
            return beams
        return beams.deskew(log(between(self._interpolate(start), self._interpolate(end))) / (1e-9 * (end - start)))

    def _interpolate(self, stamp_ns: int) -> FloatArray:
        """Return pose (3,) at a stamp; the first or the last one beyond them."""
        passed_ns = stamp_ns - int(self._stamps[0])
        x, y, theta = (np.interp(passed_ns, self._passed_ns, values) for values in self._coordinates)
        return np.array([x, y, wrap(theta)])
