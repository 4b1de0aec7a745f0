"""The tracker: matches every scan to a sliding local map, and so turns odometry into a smooth, nearly exact one.

It never looks at anything older than its local maps, so it drifts slowly but never jumps when a loop closes. The
particles take its increments as their control (Haehnel et al. 2003).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, final

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass as parameters

from gridslam.geometry.se2 import between, compose, inverse
from gridslam.grid.tiles import TileMaps
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.matching.correlative import Correlative
from gridslam.matching.gauss_newton import GaussNewton
from gridslam.types import Beams, FloatArray, Match, Odometry

__all__ = ["OdometryTracker", "Tracked", "Tracker", "TrackerState"]

_BOTH = np.array([0, 1], np.int32)
_ROWS = (np.array([0], np.int32), np.array([1], np.int32))
_LOOK = GaussNewton(max_passes=0)
_NO_PRIOR = np.full((1, 3, 3), 1e-9) * np.eye(3)


@final
@dataclass(slots=True, eq=False)
class TrackerState:
    """What the tracker remembers; arrays in it are replaced, never written to.

    Attributes
    ----------
    maps : TileMaps
        Two overlapping local maps.
    pose, odometry : (3,) float64
        Of the last scan; the pose is in the tracker's own, slowly drifting frame.
    stamp_ns : int
        Of the last scan.
    matched_pose, matched_odometry : (3,) float64
        Of the last scan that was matched.
    inserted_pose : (3,) float64
        Of the last scan that was inserted.
    active : int
        Which local map is matched against.
    scans : (int, int)
        Scans that each local map holds.
    doubt_m2, doubt_rad2 : float
        Variances of all odometry so far that was taken instead of a match that was not believed.
    """

    maps: TileMaps
    pose: FloatArray
    odometry: FloatArray
    stamp_ns: int
    matched_pose: FloatArray
    matched_odometry: FloatArray
    inserted_pose: FloatArray
    active: int = 0
    scans: tuple[int, int] = (1, 0)
    doubt_m2: float = 0.0
    doubt_rad2: float = 0.0

    def snapshot(self) -> TrackerState:
        """Keep a copy for later, at the cost of the maps' tables."""
        return replace(self, maps=self.maps.snapshot())

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Plain arrays; `from_arrays` continues to the same bytes."""
        arrays: dict[str, NDArray[Any]] = {name: getattr(self, name) for name in _POSES}
        arrays["counters"] = np.array([self.stamp_ns, self.active, *self.scans], np.int64)
        arrays["doubts"] = np.array([self.doubt_m2, self.doubt_rad2])
        return arrays | {f"maps.{name}": array for name, array in self.maps.to_arrays().items()}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]], mapper: OccupancyGridMapping) -> TrackerState:
        """Rebuild from `to_arrays`; raises KeyError where one is missing."""
        maps = mapper.restore({name[5:]: a for name, a in arrays.items() if name.startswith("maps.")})
        stamp_ns, active, first, second = (int(v) for v in arrays["counters"])
        doubt_m2, doubt_rad2 = arrays["doubts"].tolist()
        poses = {name: np.array(arrays[name], np.float64) for name in _POSES}
        return cls(
            maps, stamp_ns=stamp_ns, active=active, scans=(first, second), doubt_m2=doubt_m2, doubt_rad2=doubt_rad2,
            **poses,
        )  # fmt: skip


_POSES = ("pose", "odometry", "matched_pose", "matched_odometry", "inserted_pose")


@final
@dataclass(frozen=True, slots=True, eq=False)
class Tracked:
    """What the tracker says of one scan: poses (3,) in its frame.

    `predicted` uses only the scans before this one, `pose` this one too.
    """

    pose: FloatArray
    predicted: FloatArray


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
    beam_sigma_m : float, m
        Standard deviation of a beam's distance to the map against which the odometry's information is weighed. Far
        below a lidar's noise: beams are many, and odometry slips in ways that no variance tells. With seven times as
        much the Intel log is lost by 0.2 m and more.
    jump_m, jump_rad : float
        Odometry that moves farther between two scans than this and `speed_mps` (`turn_rps`) allow has jumped: it was
        reset, or a message was lost. Its increment is not used, and the scan is searched for around the last pose.
    poor_share : float
        A match with which a smaller share of the beams agrees is not believed: the scan sees mostly what is new, or a
        turn too fast for the scans' rate has led the descent astray. It takes the odometry.
    slip_m : float, m
        A match that moves the position farther than this from the odometry, and than four of the odometry's standard
        deviations, must convince: the wheels slipped, or a reading came late. Else something misled it (a person
        walking along, the dotted far end of a bare corridor, a scan smeared by a fast turn): the position keeps the
        odometry, and only the heading is taken.
    slip_gain : float
        Share of the beams that must agree more after such a match than before it.
    speed_mps, turn_rps : float
        Above what an indoor robot drives (m/s, rad/s).
    matcher : GaussNewton
        How a scan is matched.
    recovery : Correlative
        How a scan is matched after a jump.
    """

    still_m: float = Field(default=0.005, ge=0)
    still_rad: float = Field(default=0.005, ge=0)
    insert_m: float = Field(default=0.2, gt=0)
    insert_rad: float = Field(default=0.1, gt=0)
    map_scans: int = Field(default=20, ge=1)
    beam_sigma_m: float = Field(default=0.0016, gt=0)
    jump_m: float = Field(default=1.0, gt=0)
    jump_rad: float = Field(default=1.0, gt=0)
    poor_share: float = Field(default=0.5, ge=0, le=1)
    slip_m: float = Field(default=0.08, gt=0)
    slip_gain: float = Field(default=0.1, ge=0, le=1)
    speed_mps: float = Field(default=3.0, ge=0)
    turn_rps: float = Field(default=3.0, ge=0)
    matcher: GaussNewton = GaussNewton()
    recovery: Correlative = Correlative()

    def init(self, odometry: Odometry, stamp_ns: int, beams: Beams, mapper: OccupancyGridMapping) -> TrackerState:
        """Start at the origin of the tracker's frame with the first scan."""
        maps, pose = mapper.empty(2), np.zeros(3)
        maps.update(_ROWS[0], pose[None], beams)
        return TrackerState(maps, pose, odometry.pose, stamp_ns, pose, odometry.pose, pose)

    def step(self, state: TrackerState, odometry: Odometry, stamp_ns: int, beams: Beams) -> Tracked:
        """Track one scan; updates `state`."""
        jumped = self._jumped(state, odometry.pose, stamp_ns)
        if jumped:  # as if the robot had not moved since the last scan
            driven = between(state.matched_odometry, state.odometry)
            state.matched_odometry = compose(odometry.pose, inverse(driven))
        state.odometry, state.stamp_ns = odometry.pose, stamp_ns
        increment = between(state.matched_odometry, odometry.pose)
        predicted = compose(state.matched_pose, increment)
        moved, turned = math.hypot(increment[0], increment[1]), abs(float(increment[2]))
        if not len(beams) or (moved < self.still_m and turned < self.still_rad and not jumped):
            state.pose = predicted
            return Tracked(predicted, predicted)
        sigma_m, sigma_rad = self._odometry_sigma(moved, turned, state.maps.resolution_m)
        prior = _NO_PRIOR if jumped else self._prior(sigma_m, sigma_rad)
        matcher: GaussNewton | Correlative = self.recovery if jumped else self.matcher
        match = matcher(state.maps, _ROWS[state.active], predicted[None], prior, beams)
        pose = match.poses[0] if jumped else self._believed(state, match, predicted, sigma_m, beams)
        state.pose = state.matched_pose = pose
        state.matched_odometry = odometry.pose
        poor = bool(match.score[0] < self.poor_share * len(beams))
        if poor or jumped:
            state.doubt_m2 += sigma_m**2
            state.doubt_rad2 += sigma_rad**2
        if not (poor and turned > self.insert_rad):  # smeared by the turn, or seen at another time than the stamp's
            self._insert(state, beams)
        return Tracked(pose, predicted)

    def _jumped(self, state: TrackerState, pose: FloatArray, stamp_ns: int) -> bool:
        dx, dy, turn = (pose - state.odometry).tolist()
        seconds = abs(stamp_ns - state.stamp_ns) * 1e-9
        far = math.hypot(dx, dy) > self.jump_m + self.speed_mps * seconds
        return far or abs(math.remainder(turn, math.tau)) > self.jump_rad + self.turn_rps * seconds

    def _believed(
        self, state: TrackerState, match: Match, predicted: FloatArray, sigma_m: float, beams: Beams
    ) -> FloatArray:
        """Pose of the match or, where that is implausible, the odometry's position with the match's heading."""
        pose: FloatArray = match.poses[0]
        score = float(match.score[0])
        if score < self.poor_share * len(beams):
            return predicted
        if math.hypot(pose[0] - predicted[0], pose[1] - predicted[1]) <= max(self.slip_m, 4 * sigma_m):
            return pose
        stayed = np.array([predicted[0], predicted[1], pose[2]])
        before = _LOOK(state.maps, _ROWS[state.active], stayed[None], _NO_PRIOR, beams).score[0]
        return pose if score - float(before) > self.slip_gain * len(beams) else stayed

    def _odometry_sigma(self, moved: float, turned: float, cell: float) -> tuple[float, float]:
        """Standard deviations (m, rad) of an increment of odometry, from a tenth of a cell on."""
        return 0.1 * cell + 0.15 * moved + 0.5 * cell * turned, 0.003 + 0.05 * turned + 0.04 * moved

    def _prior(self, sigma_m: float, sigma_rad: float) -> FloatArray:
        """Information (1, 3, 3) of the odometry, beside residuals in m."""
        position, heading = (self.beam_sigma_m / sigma_m) ** 2, (self.beam_sigma_m / sigma_rad) ** 2
        return np.array([[[position, 0.0, 0.0], [0.0, position, 0.0], [0.0, 0.0, heading]]])

    def _insert(self, state: TrackerState, beams: Beams) -> None:
        dx, dy, turn = (state.pose - state.inserted_pose).tolist()
        if math.hypot(dx, dy) < self.insert_m and abs(math.remainder(turn, math.tau)) < self.insert_rad:
            return
        state.inserted_pose = state.pose
        scans, active = list(state.scans), state.active
        rows = _ROWS[active] if scans[active] < self.map_scans else _BOTH
        for row in rows.tolist():
            scans[row] += 1
        state.maps.update(rows, np.repeat(state.pose[None], len(rows), axis=0), beams)
        if scans[1 - active] >= self.map_scans:
            state.maps.clear(active)
            scans[active], state.active = 0, 1 - active
        state.scans = (scans[0], scans[1])


@final
@parameters(frozen=True, config=ConfigDict(extra="forbid"))
class OdometryTracker:
    """Takes the odometry as it is, as GMapping does."""

    def init(self, odometry: Odometry, stamp_ns: int, beams: Beams, mapper: OccupancyGridMapping) -> TrackerState:
        """Start at the origin of the tracker's frame."""
        pose = np.zeros(3)
        return TrackerState(mapper.empty(2), pose, odometry.pose, stamp_ns, pose, odometry.pose, pose)

    def step(self, state: TrackerState, odometry: Odometry, stamp_ns: int, beams: Beams) -> Tracked:
        """Track one scan; updates `state`."""
        state.pose = compose(state.matched_pose, between(state.matched_odometry, odometry.pose))
        state.odometry, state.stamp_ns = odometry.pose, stamp_ns
        return Tracked(state.pose, state.pose)
