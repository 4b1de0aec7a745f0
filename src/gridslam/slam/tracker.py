"""The tracker: matches every scan to a sliding local map, and so turns odometry into a smooth, nearly exact one.

It never looks at anything older than its local maps, so it drifts slowly but never jumps when a loop closes. The
particles take its increments as their control (Haehnel et al. 2003).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import final

import numpy as np
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass as parameters

from gridslam.geometry.se2 import between, compose
from gridslam.grid.tiles import Evidence, TileMaps
from gridslam.matching.gauss_newton import GaussNewton
from gridslam.types import Beams, FloatArray, IntArray, Odometry

__all__ = ["Tracked", "Tracker", "TrackerState"]

_BOTH = np.array([0, 1], np.int32)
_ROW = (np.array([0], np.int32), np.array([1], np.int32))


@final
@dataclass(slots=True, eq=False)
class TrackerState:
    """What the tracker remembers.

    Attributes
    ----------
    maps : TileMaps
        Two overlapping local maps.
    pose : (3,) float64
        In the tracker's own, slowly drifting frame.
    matched_pose, matched_odometry : (3,) float64
        Tracker pose and odometry of the last scan that was matched.
    inserted_pose : (3,) float64
        Pose of the last scan that was inserted.
    active : int
        Which local map is matched against.
    scans : list of int
        Scans that each local map holds.
    """

    maps: TileMaps
    pose: FloatArray
    matched_pose: FloatArray
    matched_odometry: FloatArray
    inserted_pose: FloatArray
    active: int
    scans: list[int]


@final
@dataclass(frozen=True, slots=True, eq=False)
class Tracked:
    """What the tracker says of one scan: poses (3,) in its frame.

    `predicted` uses only the scans before this one, `pose` this one too; `information` (3, 3) and `score` are the
    match's, None for a scan that was not matched.
    """

    pose: FloatArray
    predicted: FloatArray
    information: FloatArray | None = None
    score: float = float("nan")


@final
@parameters(frozen=True, config=ConfigDict(extra="forbid"))
class Tracker:
    """Matches every scan to the older of two local maps that take turns.

    Parameters
    ----------
    still_m, still_rad : float
        A scan after less odometry than both takes the odometry: there is nothing to learn from it.
    insert_m, insert_rad : float
        A scan is inserted after this much motion.
    map_scans : int
        A second local map is begun when the first holds this many scans, and replaces it when it does itself.
    odometry_weight : float
        How much the odometry's information counts against the sum of squared distances in cells. Small: beams are
        many and agree within a fraction of a cell; 50 times more loses the Intel log by 0.2 m and more.
    matcher : GaussNewton
        How a scan is matched.
    """

    still_m: float = Field(0.005, ge=0)
    still_rad: float = Field(0.005, ge=0)
    insert_m: float = Field(0.2, gt=0)
    insert_rad: float = Field(0.1, gt=0)
    map_scans: int = Field(20, ge=1)
    odometry_weight: float = Field(0.001, gt=0)
    matcher: GaussNewton = GaussNewton()

    def init(self, odometry: Odometry, beams: Beams, evidence: Evidence, resolution_m: float, reach_cells: float) -> TrackerState:
        """Start at the origin of the tracker's frame with the first scan."""
        maps = TileMaps(2, resolution_m=resolution_m, reach_cells=reach_cells, evidence=evidence)
        pose = np.zeros(3)
        maps.update(_ROW[0], pose[None], beams)
        return TrackerState(maps, pose, pose, odometry.pose, pose, 0, [1, 0])

    def step(self, state: TrackerState, odometry: Odometry, beams: Beams) -> Tracked:
        """Track one scan; updates `state`."""
        increment = between(state.matched_odometry, odometry.pose)
        predicted = compose(state.matched_pose, increment)
        moved, turned = math.hypot(increment[0], increment[1]), abs(float(increment[2]))
        if (moved < self.still_m and turned < self.still_rad) or not len(beams):
            state.pose = predicted
            return Tracked(predicted, predicted)
        prior = self._prior(moved, turned, state.maps.resolution_m)
        match = self.matcher(state.maps, _ROW[state.active], predicted[None], prior[None], beams)
        pose = match.poses[0]
        state.pose = state.matched_pose = pose
        state.matched_odometry = odometry.pose
        self._insert(state, beams)
        return Tracked(pose, predicted, match.information[0], float(match.score[0]))

    def _prior(self, moved: float, turned: float, cell: float) -> FloatArray:
        st = 0.5 * (0.2 * cell + 0.3 * moved + turned * cell)
        sa = 0.003 + 0.05 * turned + 0.002 * moved / cell
        position = self.odometry_weight * (cell / st) ** 2 / cell**2
        return np.diag([position, position, self.odometry_weight / sa**2])

    def _insert(self, state: TrackerState, beams: Beams) -> None:
        since = between(state.inserted_pose, state.pose)
        if math.hypot(since[0], since[1]) < self.insert_m and abs(since[2]) < self.insert_rad:
            return
        state.inserted_pose = state.pose
        active, other = state.active, 1 - state.active
        if state.scans[active] < self.map_scans:
            rows: IntArray = _ROW[active]
        else:
            rows = _BOTH
            state.scans[other] += 1
        state.scans[active] += 1
        state.maps.update(rows, np.repeat(state.pose[None], len(rows), axis=0), beams)
        if state.scans[other] >= self.map_scans:
            state.maps.clear(active)
            state.scans[active] = 0
            state.active = other
