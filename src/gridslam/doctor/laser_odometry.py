"""Laser odometry: the reference against which odometry and mounting are checked.

Neither is trusted, because either may be wrong. Scans are matched in the laser's own frame to a sliding local
map, from where the laser would be if it went on as before; no prior pulls the match, so that it does not lag behind.
A laser whose beams are read in the wrong direction sees the mirrored world, and matches as well in it.
"""

from __future__ import annotations

from typing import final

import numpy as np

from gridslam.geometry.se2 import between, compose, exp, log
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.matching.gauss_newton import NO_PRIOR, GaussNewton
from gridslam.models.inverse_sensor import InverseSensorModel
from gridslam.types import FloatArray, Match, StoredScan

_ROWS = (np.array([0], np.int32), np.array([1], np.int32))
_BOTH = np.array([0, 1], np.int32)
_ORIGIN = np.zeros(2)

_GOOD_SHARE = 0.75  # a match with which fewer beams agree may be a wrong one: others are tried
_LOST_SHARE = 0.35  # and with which even fewer agree ends the track: a new one is begun
_TURNS_RAD = 0.12 * np.array([0, 1, -1, 2, -2, 3, -3, 4, -4, 5, -5, 6, -6, 7, -7])
_INSERT_M = 0.3
_INSERT_RAD = 0.1
_MAP_SCANS = 10
_EVIDENCE = InverseSensorModel.from_log_odds(2.4, -0.01)
"""Beams through a wall's near side hardly free it. Where they do, the rest of a wall lies behind it, each scan is
drawn a little too far ahead, and the way comes out up to 1 % too long. So, and refined by the beams that fit best, it
is within 0.3 %, measured with noise of 3 cm."""
_ROUGH = GaussNewton()
_FINE = GaussNewton(cauchy_m=0.05)
_JITTER = 3  # stamps that go backward more often than this make single intervals unusable
_LONGEST_S = 1.0  # after a longer gap a constant velocity is no prediction


@final
class LaserOdometry:
    """Matches scan after scan; two local maps take turns, as in `gridslam.tracking.tracker`.

    Attributes
    ----------
    pose : (3,) float64
        The laser in the frame of the present track.
    track : int
        Number of times that the track was lost and restarted.
    """

    def __init__(self) -> None:
        """Wait for the first scan."""
        self._maps = OccupancyGridMapping(inverse_sensor=_EVIDENCE).empty(2)
        self.track = -1
        self._backward = 0
        self._period_s = 0.1
        self.pose = self._inserted = self._twist = np.zeros(3)

    def begin(self, stamp_ns: int, ends: FloatArray) -> None:
        """Begin a track with a scan's ends (K, 2) in the laser's frame, m."""
        self._maps.clear(0)
        self._maps.clear(1)
        self.pose = self._twist = np.zeros(3)
        self._stamp_ns = stamp_ns
        self._active = 0
        self._scans = [0, 0]
        self.track += 1
        self._insert(ends)

    def step(self, stamp_ns: int, ends: FloatArray) -> tuple[FloatArray, float]:
        """Match a scan; return the information (3, 3) of the match (see `Match`) and the share of agreeing beams.

        The share is 0 where the track was lost and this scan begins another.
        """
        seconds = self._passed(stamp_ns)
        predicted = compose(self.pose, exp(self._twist * seconds))
        match = self._match(_ROUGH, predicted[None], ends)
        if match.score[0] < _GOOD_SHARE * len(ends):
            match = self._search(predicted, match, ends)
        share = float(match.score[0]) / len(ends)
        if share < _LOST_SHARE:
            self.begin(stamp_ns, ends)
            return np.zeros((3, 3)), 0.0
        match = self._match(_FINE, match.poses, ends)
        pose = match.poses[0]
        if seconds:
            self._twist = log(between(self.pose, pose)) / seconds
        self.pose = pose
        apart = np.abs(between(self._inserted, pose))
        if np.hypot(apart[0], apart[1]) >= _INSERT_M or apart[2] >= _INSERT_RAD:
            self._insert(ends)
        return match.information[0], share

    def _passed(self, stamp_ns: int) -> float:
        """Return seconds since the last scan; the usual ones where stamps jitter so much that they go backward."""
        seconds = (stamp_ns - self._stamp_ns) * 1e-9
        self._stamp_ns = stamp_ns
        self._backward += seconds < 0
        self._period_s += 0.02 * (min(seconds, _LONGEST_S) - self._period_s)
        if self._backward > _JITTER:
            return max(self._period_s, 0.0)
        return seconds if 0 < seconds < _LONGEST_S else 0.0

    def _match(self, matcher: GaussNewton, guesses: FloatArray, ends: FloatArray) -> Match:
        rows = np.full(len(guesses), self._active, np.int32)
        priors = np.repeat(NO_PRIOR[None], len(guesses), axis=0)
        return matcher(self._maps, rows, guesses, priors, StoredScan(ends, _ORIGIN))

    def _search(self, predicted: FloatArray, first: Match, ends: FloatArray) -> Match:
        """The best of matches from turned guesses, where the laser was and where it would be, and of the first."""
        turned = np.zeros((len(_TURNS_RAD), 3))
        turned[:, 2] = _TURNS_RAD
        guesses = np.concatenate([compose(predicted, turned[1:]), compose(self.pose, turned)])
        found = self._match(_ROUGH, guesses, ends)
        best = int(found.score.argmax())
        if found.score[best] <= first.score[0]:
            return first
        return Match(found.poses[best][None], found.information[best][None], found.score[best][None])

    def _insert(self, ends: FloatArray) -> None:
        """Draw the scan into the local maps; the younger replaces the older once it holds enough."""
        self._inserted = self.pose
        rows = _ROWS[self._active] if self._scans[self._active] < _MAP_SCANS else _BOTH
        for row in rows.tolist():
            self._scans[row] += 1
        self._maps.update(rows, np.repeat(self.pose[None], len(rows), axis=0), StoredScan(ends, _ORIGIN))
        if self._scans[1 - self._active] >= _MAP_SCANS:
            self._maps.clear(self._active)
            self._scans[self._active] = 0
            self._active = 1 - self._active
