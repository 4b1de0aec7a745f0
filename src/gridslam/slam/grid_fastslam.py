"""Grid-based FastSLAM (GMapping): a particle filter over trajectories, each particle with its own occupancy grid.

p(x_1:t, m | z_1:t, u_1:t) = p(x_1:t | z_1:t, u_1:t) p(m | x_1:t, z_1:t): the particles carry the first factor, and
given its trajectory each particle's map is mapping with known poses.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from gridslam.arguments import describe
from gridslam.errors import ArgumentError
from gridslam.geometry.angles import wrap
from gridslam.geometry.se2 import between
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.models.endpoint import CauchyEndPoint
from gridslam.models.motion import DiffusionMotion
from gridslam.particles.ancestry import Ancestry
from gridslam.particles.initial import repeat_pose
from gridslam.particles.policies import EffectiveSampleSizeBelow, MotionThreshold, ResamplingPolicy, UpdatePolicy
from gridslam.particles.resampling import Systematic
from gridslam.slam.confidence import Confidence
from gridslam.slam.loop_closure import LoopClosure
from gridslam.slam.map_limit import MapLimit
from gridslam.slam.odometry_noise import OdometryNoise, is_worse_than_velocity
from gridslam.slam.odometry_tracker import OdometryTracker
from gridslam.slam.proposals import Peak, Proposal
from gridslam.slam.state import GridFastSlamState
from gridslam.slam.tracker import Tracked, Tracker
from gridslam.slam.tracker_velocity import widened
from gridslam.types import (
    Beams,
    FloatArray,
    LaserScan,
    MotionModel,
    MotionSampler,
    Odometry,
    Resampler,
    SensorModel,
    SkipReason,
    StepReport,
    require_measurement,
    require_step,
)

__all__ = ["GridFastSlam"]


@final
@dataclass(frozen=True)
class GridFastSlam:
    """The filter; it holds only its parts, and what it knows is in the state that goes in and comes out of `step`.

    Attributes
    ----------
    tracker : Tracker
        Refines the odometry at every scan, or does without; its increments are the particles' control.
    motion : MotionModel
        p(x_t | u_t, x_{t-1}), conditioned on the control.
    sensor : SensorModel
        p(z_t | x_t, m), conditioned on the scan.
    proposal : Proposal
        Draws the new poses and weighs them.
    mapper : OccupancyGridMapping
        Inserts the scan into each particle's map.
    resampler : Resampler
        Which particles survive.
    when_to_update : UpdatePolicy
        Which scans are key scans, at which the particles are stepped: by what moved since the last one of its laser.
    when_to_resample : ResamplingPolicy
        When resampling is worth its loss of diversity.
    map_limit : MapLimit
        How much the particles' maps may take.
    confidence : Confidence
        How poses' covariances and the lost flag are told.
    loop_closure : LoopClosure or None
        Recognizes old places and corrects the past; None for the filter alone.
    range_min_m, range_max_m : float
        Beams outside are not used: the first sees the robot itself, and beyond the second a lidar's beam is wider than
        what it hits.
    particles : int, >= 1
        How many particles `init` begins with, unless it is told otherwise.
    threads : int
        Threads of the kernels; never changes a result.

    Source: Probabilistic Robotics, Table 13.4; Grisetti, Stachniss and Burgard 2007; Haehnel et al. 2003.
    """

    tracker: Tracker | OdometryTracker = Tracker()
    motion: MotionModel = DiffusionMotion()
    sensor: SensorModel = CauchyEndPoint()
    proposal: Proposal = Peak()
    mapper: OccupancyGridMapping = OccupancyGridMapping()
    resampler: Resampler = Systematic()
    when_to_update: UpdatePolicy = MotionThreshold()
    when_to_resample: ResamplingPolicy = EffectiveSampleSizeBelow()
    map_limit: MapLimit = MapLimit()
    confidence: Confidence = Confidence()
    loop_closure: LoopClosure | None = None
    range_min_m: float = 0.05
    range_max_m: float = 30.0
    particles: int = 30
    threads: int = 1

    def init(
        self,
        odometry: Odometry | None,
        scan: LaserScan,
        particles: int | FloatArray | None = None,
        pose: ArrayLike = (0.0, 0.0, 0.0),
    ) -> tuple[GridFastSlamState, StepReport]:
        """Begin with a first scan.

        Parameters
        ----------
        odometry : Odometry or None
            None where there is none: here, at any later scan, or at all of them.
        scan : LaserScan
            One without a usable beam is fine.
        particles : int or (N, 3) float64, optional
            How many particles start at `pose` (3,), or where each starts (see `gridslam.particles.sample_gaussian`); as
            many as the filter's own `particles` if not given.
        pose : (3,) float64
            Where they start, map frame [x m, y m, theta rad].

        Raises
        ------
        ArgumentError
            An argument is of another kind, or the tracker needs odometry and there is none.
        """
        require_measurement(odometry, scan)
        particles = self.particles if particles is None else particles
        poses = repeat_pose(int(particles), pose) if isinstance(particles, int | np.integer) else _given(particles)
        poses[:, 2] = wrap(poses[:, 2])
        beams = scan.beams(self.range_min_m, self.range_max_m)
        tracker = self.tracker.init(odometry, scan.stamp_ns, beams, self.mapper)
        maps = self.mapper.empty(len(poses), self.threads)
        self.mapper(maps, poses, beams)
        equal = np.full(len(poses), -np.log(len(poses)))
        state = GridFastSlamState(
            tracker, tracker.pose, {scan.sensor: tracker.pose}, poses, equal, np.zeros(len(poses)), np.zeros((3, 3)),
            maps, Ancestry.start(poses),
        )  # fmt: skip
        if self.loop_closure is not None:
            self.loop_closure.init(state, beams)
        return state, self.confidence.first_scan(state, scan)

    def step(
        self, state: GridFastSlamState, odometry: Odometry | None, scan: LaserScan, rng: np.random.Generator
    ) -> tuple[GridFastSlamState, StepReport]:
        """Take one measurement; consumes `state` (keep one for later with `state.snapshot()`).

        Every scan is tracked; at a key scan the particles are predicted, matched, weighed, mapped and resampled.
        """
        require_step(GridFastSlamState, state, odometry, scan, rng)
        state, beams = state.take(), scan.beams(self.range_min_m, self.range_max_m)
        tracked, noise = self._track(state, odometry, beams)
        beams, moved = tracked.beams, between(state.key_pose, tracked.pose)
        if reason := self._skip(state, tracked.pose, beams):
            return self._close_loops(state, self.confidence.between_key_scans(state, scan, moved, reason), beams)
        motion = self._predict(state, tracked, noise)  # predict
        weigh = self.sensor(beams)
        proposed = self.proposal(state.maps, state.poses, motion, weigh, tracked.joint, rng)  # match and weigh
        self.mapper(state.maps, proposed.poses, beams)  # map
        state.advance(proposed, tracked.pose, scan.sensor)
        report = self.confidence.key_scan(state, scan, moved, proposed, tracked.joint)
        if self.when_to_resample(report.n_eff, len(state.poses)):  # resample
            parents = self.resampler(np.exp(state.log_weights), len(state.poses), rng)
            state.resample(parents)
            report = replace(report, parents=parents, best=state.best)
        return self._close_loops(state, self._bounded(state, report), beams)

    def _bounded(self, state: GridFastSlamState, report: StepReport) -> StepReport:
        """Keep the particles' maps within their limit."""
        kept = self.map_limit(state)
        if kept is None:
            return report
        state.resample(kept)
        parents = kept if report.parents is None else report.parents[kept]
        return replace(report, parents=parents, best=state.best)

    def _track(
        self, state: GridFastSlamState, odometry: Odometry | None, beams: Beams
    ) -> tuple[Tracked, OdometryNoise | None]:
        """Track a scan, by odometry unless that is told to be of no use; and what is told of its noise."""
        tracker, stamp_ns = self.tracker, beams.scan.stamp_ns
        if odometry is not None and isinstance(tracker, Tracker):
            seconds = 1e-9 * abs(stamp_ns - state.tracker.stamp_ns)
            odometry = None if is_worse_than_velocity(odometry, seconds, tracker.velocity) else odometry
        noise = OdometryNoise.told(state, odometry, matched=isinstance(tracker, Tracker))
        state.odometry_covariance = None if noise is None else noise.covariance
        return tracker.step(state.tracker, odometry, stamp_ns, beams), noise

    def _predict(self, state: GridFastSlamState, tracked: Tracked, noise: OdometryNoise | None) -> MotionSampler:
        """Condition the motion on the control: the tracked motion since the last key scan, up to this scan."""
        motion = widened(self.motion(between(state.key_pose, tracked.predicted)), tracked.spread)
        return motion if noise is None else noise.added(motion, state.key_pose, tracked.predicted)

    def _close_loops(
        self, state: GridFastSlamState, report: StepReport, beams: Beams
    ) -> tuple[GridFastSlamState, StepReport]:
        if self.loop_closure is None or state.memory is None:
            return state, report
        return state, self.loop_closure(state, state.memory, report, beams, self.mapper, self.threads)

    def _skip(self, state: GridFastSlamState, pose: FloatArray, beams: Beams) -> SkipReason | None:
        last = state.sensor_key_poses.get(beams.scan.sensor)
        if last is not None:
            dx, dy, turn = between(last, pose).tolist()
            if not self.when_to_update(math.hypot(dx, dy), abs(turn)):
                return SkipReason.BETWEEN_KEY_SCANS
        return None if len(beams) else SkipReason.NO_VALID_BEAM


def _given(particles: object) -> FloatArray:
    """Poses (N, 3) that were given as particles, copied."""
    try:
        poses = np.array(particles, np.float64)
    except (TypeError, ValueError):
        poses = np.empty(0)
    if poses.ndim != 2 or poses.shape[1] != 3 or not len(poses) or not np.isfinite(poses).all():
        raise ArgumentError("particles", "a number, or finite poses of shape (N, 3)", describe(particles))
    return poses
