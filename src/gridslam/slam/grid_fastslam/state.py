"""The state of grid-based FastSLAM: explicit, with one owner, and with one versioned schema."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Annotated, Any, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from gridslam import serialization
from gridslam.arguments import COUNT, Limits, Size, index_of
from gridslam.checked import checked
from gridslam.errors import ArgumentError
from gridslam.geometry.angles import wrap_headings
from gridslam.geometry.single_pose import Pose
from gridslam.grid.tiles import TileMaps
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.particles.ancestry import Ancestry
from gridslam.particles.resampling import normalize, require_log_weights
from gridslam.serialization import NOT_SAVED
from gridslam.slam.grid_fastslam.smoothed_pose import SmoothedPose
from gridslam.slam.loop_closure.drift_model import compute_moments
from gridslam.slam.loop_closure.state import LoopClosureState
from gridslam.tracking.state import UnmatchedMotion
from gridslam.tracking.tracker import TrackerState
from gridslam.types import FloatArray, IntArray, OwnedState, describe_pose

STATE_SCHEMA = "gridslam.state/17"

_DECISIVE = 3.0
"""Nats, odds of 20 to 1, by which another particle is better before it is reported in place of the one that was: else
the pose would jump to and fro between places that fit about as well. Kass and Raftery, Bayes factors (1995), call this
strong evidence."""


@final
class Estimate(NamedTuple):
    """Estimate of the weighted particles at a key scan, before resampling, which only loses information."""

    reported: SmoothedPose  # of the best particle
    covariance: Callable[[], FloatArray]  # (3, 3), of that pose, given its map: computed when it is asked for
    drift_covariance: FloatArray  # (3, 3), what the drift grew by since the last key scan, in the frame of that pose
    degenerate_direction: FloatArray | None  # direction that the match leaves open
    lost: bool
    poses: FloatArray  # (N, 3)
    log_weights: FloatArray  # (N,)


@final
class BeforeStep(NamedTuple):
    """Values that revive a consumed state: counts, and the tracker's values used at a key scan."""

    key_scans: int = 0
    scans: int = 0
    unmatched: UnmatchedMotion = UnmatchedMotion()


@final
@dataclass(slots=True, eq=False)
class GridFastSlamState(OwnedState):
    """Everything that the filter knows between two scans; arrays in it are replaced, never written to.

    Attributes
    ----------
    tracker : TrackerState
        The tracker's local maps and pose.
    key_pose : Pose
        The tracker's pose at the last key scan.
    sensor_key_poses : dict of str to Pose
        The tracker's pose at the last key scan of each laser; replaced, never written to.
    poses : (N, 3) float64
        The particles at the last key scan, map frame.
    log_weights : (N,) float64, nats
        Normalized.
    reported : SmoothedPose
        The best particle's pose at the last key scan, by its motion and by all its matches.
    log_ancestry : (N,) float64, nats
        Log weight of each particle accumulated along its ancestry, relative to the greatest.
    particles_max : int
        Greatest number of particles: that at the start.
    drift : (9,) float64
        Moments of what that pose has drifted by since the start (see `gridslam.slam.loop_closure.drift_model`).
    tracked_scans : int
        Scans since the last key scan.
    drift_covariance : (3, 3) float64
        What the drift grew by since the key scan before, in the frame of the last one's pose.
    unmatched : UnmatchedMotion
        Of the motion that led to the last key scan.
    maps : TileMaps
        One map for each particle.
    ancestry : Ancestry
        All particles' trajectories over the key scans.
    lost : bool
        Whether the last key scan agreed with the best map too little.
    closure_state : LoopClosureState or None
        What loop closure remembers, where it is at work.
    best : int
        Index of the particle that is reported: one of great log weight accumulated along its ancestry, and its
        descendants from then on, or what is nearest to it where it has none, until another one is better by odds of 20
        to 1.
    """

    tracker: TrackerState
    key_pose: Pose
    sensor_key_poses: dict[str, Pose]
    poses: Annotated[FloatArray, "N", 3]
    log_weights: Annotated[FloatArray, "N"]
    log_ancestry: Annotated[FloatArray, "N"]
    _covariance: Annotated[FloatArray, 3, 3] | Callable[[], FloatArray]
    reported: SmoothedPose
    maps: Annotated[TileMaps, "N"]
    ancestry: Annotated[Ancestry, "N", Size("T", "steps")]
    particles_max: Annotated[int, Limits(1, 1 << 30)]
    drift: Annotated[FloatArray, 9] = field(default_factory=lambda: np.zeros(9))
    drift_covariance: Annotated[FloatArray, 3, 3] = field(default_factory=lambda: np.zeros((3, 3)))
    unmatched: UnmatchedMotion = field(default_factory=UnmatchedMotion)
    lost: bool = False
    tracked_scans: Annotated[int, COUNT] = 0
    closure_state: LoopClosureState | None = None
    best: Annotated[int, index_of("N")] = 0
    before_step: BeforeStep = field(default=BeforeStep(), metadata=NOT_SAVED)  # when it was consumed

    def __repr__(self) -> str:
        """Return one line."""
        if self.consumed:
            return "GridFastSlamState(consumed)"
        best = describe_pose(self.poses[self.best])
        lost = ", lost" if self.lost else ""
        return f"GridFastSlamState({len(self.poses)} particles, the best at {best}{lost})"

    @property
    def covariance(self) -> FloatArray:
        """Covariance (3, 3) of the best particle's pose at the last key scan, given its map; computed each time."""
        return self.defer_covariance()()

    def defer_covariance(self) -> Callable[[], FloatArray]:
        """What computes that covariance, though this state goes on: most key scans are over before somebody asks."""
        covariance = self._covariance
        return covariance if callable(covariance) else lambda: covariance

    @property
    def best_pose(self) -> FloatArray:
        """Pose (3,) of the best particle at the last key scan, map frame."""
        return np.asarray(self.poses[self.best])

    def best_trajectory(self) -> FloatArray:
        """Poses (T, 3) of the best particle at all key scans."""
        return self.ancestry.trajectory(self.best)

    def take(self) -> GridFastSlamState:
        """Hand the contents over to a new owner; this one raises ConsumedStateError from now on."""
        self.require_owned()
        owner = replace(self)
        self.consumed = True
        scans = 0 if self.closure_state is None else len(self.closure_state.scans)
        self.before_step = BeforeStep(self.ancestry.steps, scans, self.tracker.unmatched)
        return owner

    def revive(self) -> None:
        """Undo a failed step: restore the state, except for values that the step wrote in place.

        The tracker may have followed the scan, and maps may hold it where it was matched. If the particles were
        resampled already, they are those that survived, with equal weights. The graph may be corrected already.
        """
        if not self.consumed:
            return
        key_scans, scans, unmatched = self.before_step
        if self.ancestry.steps > key_scans:
            self.tracker.unmatched = unmatched
            poses = self.ancestry.retract()
            if not np.array_equal(poses, self.poses):
                self.poses = poses
                self.log_weights = np.full(len(poses), -np.log(len(poses)))
                self.log_ancestry = np.zeros(len(poses))
        if self.closure_state is not None:
            self.closure_state.truncate(scans, key_scans)
        self.maps = self.maps.snapshot()  # another object: whoever shows it looks at all of it again
        self.consumed = False

    def move(self, poses: FloatArray, key_pose: Pose, sensor: str) -> None:
        """Move the particles to `poses` (N, 3); `key_pose` is the tracker's, at a key scan of `sensor`."""
        self.poses = poses
        self.ancestry.extend(poses)
        self.key_pose = key_pose
        self.tracked_scans = 0
        self.sensor_key_poses = {**self.sensor_key_poses, sensor: key_pose}
        self.unmatched = self.tracker.take_unmatched()

    def weigh(self, log_weights: FloatArray) -> None:
        """Weigh the particles by the log likelihoods (N,), in nats, of a scan."""
        self.log_weights = normalize(self.log_weights + log_weights)
        accumulated = self.log_ancestry + log_weights
        self.log_ancestry = accumulated - accumulated.max()
        if self.log_ancestry[self.best] < -_DECISIVE:
            self.best = int(self.log_ancestry.argmax())

    def accept(self, estimate: Estimate) -> None:
        """Accept the estimate at a key scan."""
        self.reported = estimate.reported
        self.lost = estimate.lost
        self._covariance = estimate.covariance
        self.drift_covariance = estimate.drift_covariance

    def accumulate_drift(self) -> None:
        """Add the growth of the drift at this key scan; loop closure computes it along the most certain way instead."""
        self.drift = self.drift + compute_moments(self.reported.pose[None], self.drift_covariance[None])[0]

    def resample(self, parents: IntArray) -> None:
        """Let particle i continue particle parents[i], all with equal weights.

        Where the best one has no child, it was lost by chance: the one nearest to it goes on as the best.
        """
        away = wrap_headings(self.poses[parents] - self.poses[self.best])
        self.best = int(np.square(away).sum(axis=1).argmin())
        self.poses = self.poses[parents]
        self.maps.select(parents)
        self.ancestry.resample(parents)
        self.log_ancestry = self.log_ancestry[parents]
        self.log_weights = np.full(len(parents), -np.log(len(parents)))

    def keep_best(self) -> None:
        """Let the best particle be the only one, and give back the memory of the others' maps and of all caches."""
        self.resample(np.array([self.best]))
        self.maps.compact()
        self.closure_state = None if self.closure_state is None else self.closure_state.snapshot()

    def replace_trajectory(self, trajectory: FloatArray, maps: TileMaps) -> None:
        """Let all particles share one past, poses (T, 3), and the first of `maps`, with equal weights."""
        count = len(self.poses)
        self.poses = np.repeat(trajectory[-1:], count, axis=0)
        self.reported = SmoothedPose(trajectory[-1])
        self.maps = maps.snapshot(np.zeros(count, np.int64))
        self.ancestry = Ancestry.from_trajectory(trajectory, count)
        self.log_weights = np.full(count, -np.log(count))
        self.log_ancestry = np.zeros(count)
        self.best = 0

    def snapshot(self) -> GridFastSlamState:
        """Keep this state for later, at the cost of its tables: maps are copied only where either side writes."""
        self.require_owned()
        return replace(
            self,
            tracker=self.tracker.snapshot(),
            maps=self.maps.snapshot(),
            ancestry=self.ancestry.snapshot(),
            closure_state=None if self.closure_state is None else self.closure_state.snapshot(),
        )

    def copy(self) -> GridFastSlamState:
        """Return this state as it is now, for another thread: its maps share no memory with those of this one."""
        twin = self.snapshot()
        twin.tracker.maps = self.tracker.maps.copy()
        twin.maps = self.maps.copy()
        closure_state = twin.closure_state
        if closure_state is not None and closure_state.correction is not None:
            closure_state.correction.maps = closure_state.correction.maps.copy()
        return twin

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Plain arrays under the schema `STATE_SCHEMA`; `from_arrays` continues with identical results."""
        self.require_owned()
        computed = replace(self, _covariance=self.covariance)
        return {"schema": np.array(STATE_SCHEMA), **serialization.to_arrays(computed)}

    @classmethod
    @checked
    def from_arrays(
        cls, arrays: Mapping[str, NDArray[Any]], mapper: OccupancyGridMapping, threads: int = 1
    ) -> GridFastSlamState:
        """Rebuild the state of a filter with this mapper; ArgumentError for a wrong schema or a missing array."""
        schema = str(arrays.get("schema", "none"))
        if schema != STATE_SCHEMA:
            raise ArgumentError("arrays", f"a state of schema {STATE_SCHEMA}", schema)
        state = serialization.from_arrays(cls, arrays, {TileMaps: partial(mapper.restore, threads=threads)})
        require_log_weights(state.log_weights)
        state.tracker.maps.threads = 1  # two maps are faster without
        return state
