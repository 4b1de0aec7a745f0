"""State and result of the tracker."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Annotated, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from gridslam.arguments import COUNT, Limits
from gridslam.geometry.se2 import transform_points
from gridslam.geometry.single_pose import ORIGIN, UNKNOWN_POSE, Pose, as_pose, between, is_within
from gridslam.grid.tiles import TileMaps
from gridslam.matching.beam_order import BeamOrder
from gridslam.matching.branch_and_bound import Pyramid
from gridslam.serialization import NOT_SAVED
from gridslam.tracking.odometry_calibration import OdometryErrorModel
from gridslam.tracking.recent_scans import RecentScans
from gridslam.types import BeamEnds, Beams, FloatArray, Odometry, StoredScan

_BOTH = np.array([0, 1], np.int32)
_SHORTEST_INTERVAL_S = 0.005
"""No laser, nor two together, measures more often; stamps that are all the same give no interval at all."""

_ORDER_MARGIN = 0.005
"""Gain of the inlier ratio, averaged over scans, required to use an order of beams other than the reported one."""

_ORDER_PRIOR_SCANS = 20
"""Prior weight of the reported order of beams, in scans."""

_ROWS = (np.array([0], np.int32), np.array([1], np.int32))


@final
class SensorTrack(NamedTuple):
    """Track of one laser; lasers are distinguished by `sensor`."""

    stamp_ns: int  # of its last scan that was matched
    matched_pose: Pose  # of that scan
    inlier_ratio: float  # inlier ratio of that match; 0 if it was rejected
    inserted_pose: Pose  # of its last scan that was inserted
    beam_order: BeamOrder = BeamOrder()
    # of that scan, base frame; kept where there are several lasers
    ends: Annotated[FloatArray, None, 2] = np.zeros((0, 2))

    @classmethod
    def first(cls, stamp_ns: int, pose: Pose) -> SensorTrack:
        """After its first scan, from `pose`."""
        return cls(stamp_ns, pose, 1.0, pose)

    @property
    def best_order(self) -> int:
        """Order in which its beams are measured, one of `gridslam.matching.beam_order.ORDERS`."""
        return self.beam_order.best(_ORDER_MARGIN, _ORDER_PRIOR_SCANS)


@final
@dataclass(frozen=True, slots=True, eq=False)
class UnmatchedMotion:
    """Uncertainty of motion that no scan match has measured: the prediction took its place.

    Attributes
    ----------
    position_m2, heading_rad2 : float
        Accumulated variances of predictions used in place of a rejected match.
    open_covariance : (2, 2) float64, m^2
        Accumulated covariance of predictions along directions that matches left open, tracker's frame.
    """

    position_m2: float = 0.0
    heading_rad2: float = 0.0
    open_covariance: Annotated[FloatArray, 2, 2] = field(default_factory=lambda: np.zeros((2, 2)))


@final
@dataclass(slots=True, eq=False)
class TrackerState:
    """State of the tracker; arrays are replaced, never modified in place.

    Attributes
    ----------
    maps : TileMaps
        Two overlapping local maps.
    pose : Pose
        Of the last scan, in the tracker's own, slowly drifting frame.
    stamp_ns : int
        Of the last scan.
    odometry : Pose
        Of the last scan; NaN where it had none.
    matched_pose, matched_odometry : Pose
        Of the last scan that was matched where the odometry led to, from which it goes on.
    sensors : dict of str to SensorTrack
        The last of each laser.
    odometry_errors : OdometryErrorModel
        What the odometry's errors are.
    twist : Pose
        Velocity of the base in its own frame, m/s and rad/s.
    velocity_variances : (float, float)
        Variances of what velocities predicted lately, m^2 (each of x and y) and rad^2.
    period_s : float
        Mean difference of the stamps of successive scans; negative where stamps run backward.
    mean_step : float
        Mean way between scans while the robot moves, m + rad.
    stamps_unreliable : bool
        Stamps are unreliable: the time between scans is taken as `interval_s`.
    matched_map : int
        Which local map is matched against.
    scans : (int, int)
        Scans that each local map holds.
    unlocalized_scans : int
        Consecutive scans without a valid match and without odometry.
    rejected_odometry : int
        Number of scans whose odometry was rejected (jump, latency, or not trusted).
    unmatched : UnmatchedMotion
        Uncertainty of what no match has measured since the last key scan.
    open_way_m : float
        Way since the last match that left no direction open.
    recent : RecentScans
        Scans of the last metres in the local map, to the surfaces of which the next one is matched.
    pyramid : Pyramid or None
        Of the local map that is matched against, where it was searched since a scan was inserted.
    """

    maps: Annotated[TileMaps, 2]
    pose: Pose
    stamp_ns: int
    odometry: Pose
    matched_pose: Pose
    matched_odometry: Pose
    sensors: dict[str, SensorTrack]
    odometry_errors: OdometryErrorModel = field(default_factory=OdometryErrorModel)
    twist: Pose = ORIGIN
    velocity_variances: tuple[float, float] = (0.02**2, 0.03**2)
    period_s: float = 0.1
    mean_step: float = 0.0
    stamps_unreliable: bool = False
    matched_map: Annotated[int, Limits(0, 1)] = 0
    scans: tuple[Annotated[int, COUNT], Annotated[int, COUNT]] = (1, 0)
    unlocalized_scans: Annotated[int, COUNT] = 0
    rejected_odometry: Annotated[int, COUNT] = 0
    unmatched: UnmatchedMotion = field(default_factory=UnmatchedMotion)
    open_way_m: float = 0.0
    recent: RecentScans = field(default_factory=RecentScans)
    pyramid: Pyramid | None = field(default=None, metadata=NOT_SAVED)

    @classmethod
    def start(cls, maps: TileMaps, odometry: Odometry | None, stamp_ns: int, sensor: str) -> TrackerState:
        """Begin at the origin of the tracker's frame."""
        reading = pose_of(odometry)
        track = SensorTrack.first(stamp_ns, ORIGIN)
        return cls(maps, ORIGIN, stamp_ns, reading, ORIGIN, reading, {sensor: track})

    @property
    def row(self) -> NDArray[np.int32]:
        """The local map that is matched against, (1,)."""
        return _ROWS[self.matched_map]

    @property
    def interval_s(self) -> float:
        """Mean time between scans, > 0: their order is the true one, whether stamps run backward or stand still."""
        interval_s = abs(self.period_s)
        return interval_s if interval_s > _SHORTEST_INTERVAL_S else _SHORTEST_INTERVAL_S

    def update_track(self, sensor: str, track: SensorTrack) -> None:
        """Keep the last of a laser; copies that were made before do not change."""
        self.sensors = {**self.sensors, sensor: track}

    def merge_lasers(self, beams: Beams, pose: Pose, metres: float, radians: float) -> BeamEnds:
        """The scan, taken at about `pose`, with the other lasers' last scans from no farther away.

        All lasers are one sensor: each alone may see a single wall.
        """
        if len(self.sensors) == 1 and beams.scan.sensor in self.sensors:
            return beams
        others = [
            transform_points(between(pose, track.matched_pose), track.ends)
            for sensor, track in self.sensors.items()
            if sensor != beams.scan.sensor and is_within(track.matched_pose, pose, metres, radians)
        ]
        return StoredScan(np.concatenate([beams.ends, *others]), beams.origin) if others else beams

    def insert(self, beams: Beams, most: int) -> None:
        """Insert a scan at the current pose; the local maps alternate after `most` scans of each laser."""
        self.pyramid = None
        scans = list(self.scans)
        active = self.matched_map
        full = most * len(self.sensors)
        rows = _ROWS[active] if scans[active] < full else _BOTH
        for row in rows.tolist():
            scans[row] += 1
        self.maps.update(rows, np.array([self.pose] * len(rows)), beams)
        if scans[1 - active] >= full:
            self.maps.clear(active)
            scans[active] = 0
            self.matched_map = 1 - active
        self.scans = (scans[0], scans[1])

    def take_unmatched(self) -> UnmatchedMotion:
        """Return the values accumulated since the last key scan, and reset them."""
        taken = self.unmatched
        self.unmatched = UnmatchedMotion()
        return taken

    def snapshot(self) -> TrackerState:
        """Keep a copy for later, at the cost of the maps' tables."""
        return replace(self, maps=self.maps.snapshot(), odometry_errors=replace(self.odometry_errors))


def pose_of(odometry: Odometry | None) -> Pose:
    """The pose that is read; NaN where there is none."""
    return UNKNOWN_POSE if odometry is None else as_pose(odometry.pose)


@final
class Control(NamedTuple):
    """Where the particles look for a scan.

    Attributes
    ----------
    pose : Pose
        In the tracker's frame.
    variances : (float, float) or None
        Of that pose, m^2 (each of x and y) and rad^2, beside the noise of the motion model, so that particles are drawn
        about it; None where the motion model's noise is all.
    common_variances : (float, float) or None
        Of an error that all particles share, which their matches to their maps find; they are not drawn about it.
    """

    pose: Pose
    variances: tuple[float, float] | None = None
    common_variances: tuple[float, float] | None = None

    @property
    def is_certain(self) -> bool:
        """Whether the motion model's noise is all that the pose errs by."""
        return self.variances is None and self.common_variances is None


@final
class TrackedScan(NamedTuple):
    """Result of tracking one scan.

    Attributes
    ----------
    pose, predicted : Pose
        In the tracker's frame; `predicted` uses only the scans before this one, `pose` this one too.
    control : Control
        Where the particles look for it.
    beams : Beams
        As seen from the base at the stamp: deskewed.
    merged_beams : BeamEnds
        These, and what the other lasers saw a moment ago: what is to be matched, as each laser alone may see a single
        wall. Weighing takes `beams` alone: what the other lasers saw has been weighed at their own key scans.
    """

    pose: Pose
    predicted: Pose
    control: Control
    beams: Beams
    merged_beams: BeamEnds
