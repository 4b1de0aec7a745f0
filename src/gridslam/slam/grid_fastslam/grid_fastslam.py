"""Grid-based FastSLAM (GMapping): a particle filter over trajectories, each particle with its own occupancy grid.

p(x_1:t, m | z_1:t, u_1:t) = p(x_1:t | z_1:t, u_1:t) p(m | x_1:t, z_1:t): the particles carry the first factor, and
given its trajectory each particle's map is mapping with known poses.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from gridslam.checked import checked
from gridslam.geometry.single_pose import Pose, between
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.models.endpoint import CauchyEndPoint
from gridslam.models.motion import DiffusionMotion, add_noise
from gridslam.particles.ancestry import Ancestry
from gridslam.particles.initial import copy_poses, repeat_pose
from gridslam.particles.kld_sampling import count_needed
from gridslam.particles.policies import EffectiveSampleSizeBelow, MotionThreshold, ResamplingPolicy, UpdatePolicy
from gridslam.particles.resampling import Systematic, compute_spread, effective_sample_size
from gridslam.scan import Thinning
from gridslam.slam.grid_fastslam.map_limit import MapLimit
from gridslam.slam.grid_fastslam.motion_of_particles import MotionOfAll, SearchingMotion
from gridslam.slam.grid_fastslam.proposals import Proposal, ScanMatchedProposal
from gridslam.slam.grid_fastslam.report_builder import ReportBuilder
from gridslam.slam.grid_fastslam.smoothed_pose import SmoothedPose
from gridslam.slam.grid_fastslam.state import GridFastSlamState
from gridslam.slam.loop_closure.loop_closure import LoopClosure
from gridslam.tracking.tracker import OdometryTracker, TrackedScan, Tracker
from gridslam.types import (
    Beams,
    FloatArray,
    IntArray,
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


@final
@checked
@dataclass(frozen=True)
class GridFastSlam:
    """The filter: it holds only its components; `step` takes the state and returns the next one.

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
    reports : ReportBuilder
        Builds the step reports: covariances and the lost flag.
    loop_closure : LoopClosure or None
        Detects loop closures and corrects the trajectory; None to disable it.
    range_min_m, range_max_m : float
        Beams outside are not used: the first sees the robot itself, and beyond the second a lidar's beam is wider than
        what it hits.
    thinning : Thinning
        How many beams of a dense scan are used.
    particles : int, >= 1
        Default number of particles of `init`.
    particles_min : int, >= 1
        Least number of particles, where all agree on where the robot is; if `init` begins with no more than that, their
        number is fixed.
    threads : int
        Threads of the kernels; never changes a result.

    References
    ----------
    Probabilistic Robotics, Table 13.4; Grisetti, Stachniss and Burgard 2007; Haehnel et al. 2003.
    """

    tracker: Tracker | OdometryTracker = Tracker()
    motion: MotionModel = DiffusionMotion()
    sensor: SensorModel = CauchyEndPoint()
    proposal: Proposal = ScanMatchedProposal()
    mapper: OccupancyGridMapping = OccupancyGridMapping()
    resampler: Resampler = Systematic()
    when_to_update: UpdatePolicy = MotionThreshold()
    when_to_resample: ResamplingPolicy = EffectiveSampleSizeBelow()
    map_limit: MapLimit = MapLimit()
    reports: ReportBuilder = ReportBuilder()
    loop_closure: LoopClosure | None = None
    range_min_m: float = 0.05
    range_max_m: float = 30.0
    thinning: Thinning = Thinning()
    particles: int = 30
    particles_min: int = 8
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
            many as the filter's own `particles` if not given. That is their greatest number.
        pose : (3,) float64
            Where they start, map frame [x m, y m, theta rad].

        Raises
        ------
        ArgumentError
            An argument is of another kind, or the tracker needs odometry and there is none.
        """
        require_measurement(odometry, scan)
        particles = self.particles if particles is None else particles
        is_count = isinstance(particles, int | np.integer)
        expected = "a number, or finite poses of shape (N, 3)"
        poses = repeat_pose(int(particles), pose) if is_count else copy_poses(particles, 1, expected)
        beams = self._select(scan)
        tracker = self.tracker.init(odometry, scan.stamp_ns, beams, self.mapper)
        maps = self.mapper.empty(len(poses), self.threads)
        self.mapper(maps, poses, beams)
        equal = np.full(len(poses), -np.log(len(poses)))
        state = GridFastSlamState(
            tracker,
            tracker.pose,
            {scan.sensor: tracker.pose},
            poses,
            equal,
            np.zeros(len(poses)),
            compute_spread(poses, equal, 0),
            SmoothedPose(poses[0]),
            maps,
            Ancestry.start(poses),
            len(poses),
        )
        if self.loop_closure is not None:
            state.closure_state = self.loop_closure.init(state, beams)
        return state, self.reports.first_scan(state, scan, effective_sample_size(state.log_weights))

    def step(
        self, state: GridFastSlamState, odometry: Odometry | None, scan: LaserScan, rng: np.random.Generator
    ) -> tuple[GridFastSlamState, StepReport]:
        """Take one measurement; consumes `state` (keep one for later with `state.snapshot()`).

        Every scan is tracked; at a key scan the particles are predicted, matched, weighed, mapped and resampled.
        All lasers are matched, as one alone may see a single wall; only this scan weighs: the others have, each at its
        own key scan, and evidence counts once.
        """
        require_step(GridFastSlamState, state, odometry, scan, rng)
        state = state.take()
        tracked = self.tracker.step(state.tracker, odometry, scan.stamp_ns, self._select(scan))
        state.tracked_scans += 1
        beams = tracked.beams
        moved = between(state.key_pose, tracked.pose)
        if reason := self._skip(state, tracked.pose, beams):
            return self._close_loops(state, self.reports.between_key_scans(state, scan, moved, reason), beams)
        motion = self._predict(state, tracked)  # predict
        likelihood = self.sensor(beams)
        proposed = self.proposal(state.maps, state.poses, motion, likelihood, tracked.merged_beams, rng)  # match
        state.move(proposed.poses, tracked.pose, scan.sensor)
        state.weigh(proposed.log_weights)  # weigh
        self.mapper(state.maps, state.poses, beams)  # map
        estimate = self.reports.estimate(state, motion, moved, proposed.match, tracked.merged_beams)
        state.accept(estimate)
        n_eff = effective_sample_size(state.log_weights)  # N_eff
        parents, needed = None, self._count_needed(state, tracked)
        if self.when_to_resample(n_eff, len(state.poses), needed):  # resample
            parents = self.resampler(np.exp(state.log_weights), needed, rng)
            state.resample(parents)
        parents = self._bound(state, parents)
        report = self.reports.key_scan(state, scan, moved, estimate, n_eff, parents)  # report
        return self._close_loops(state, report, beams)

    def _select(self, scan: LaserScan) -> Beams:
        """Select the beams that are used."""
        return scan.beams(self.range_min_m, self.range_max_m, self.thinning)

    def _count_needed(self, state: GridFastSlamState, tracked: TrackedScan) -> int:
        """Return how many particles the belief needs, within the bounds; all where the tracker left the motion open."""
        if not tracked.control.is_certain:
            return state.particles_max
        return min(max(count_needed(state.poses, state.best_pose), self.particles_min), state.particles_max)

    def _bound(self, state: GridFastSlamState, parents: IntArray | None) -> IntArray | None:
        """Keep the particles' maps within their limit; gives the parents of the particles that are left."""
        kept = self.map_limit(state)
        if kept is None:
            return parents
        state.resample(kept)
        return kept if parents is None else parents[kept]

    def _predict(self, state: GridFastSlamState, tracked: TrackedScan) -> MotionSampler:
        """Condition the motion on the control: the tracked motion since the last key scan, up to this scan.

        Both the control and the weight know of this scan, but of different maps: those of the scans just before it, and
        the particle's own. A control that did not know of it would err by the odometry since the last scan, ten times
        what the tracker errs by.
        """
        control = tracked.control
        motion = self.motion(np.array(between(state.key_pose, control.pose)))
        is_measured = control.common_variances is None and not state.tracker.unmatched.position_m2
        scans = state.tracked_scans if is_measured else 1  # where each was matched, and none far from the one before
        if control.variances is not None:
            wide = add_noise(motion, np.diag(np.take(control.variances, [0, 0, 1])))
            motion = SearchingMotion(wide, state.maps, self.sensor(tracked.beams), tracked.beams.ends)
        return MotionOfAll(motion, state.best, scans, control.common_variances)

    def _close_loops(
        self, state: GridFastSlamState, report: StepReport, beams: Beams
    ) -> tuple[GridFastSlamState, StepReport]:
        if self.loop_closure is not None and state.closure_state is not None:
            report = self.loop_closure(state, state.closure_state, report, beams, self.mapper, self.threads)
        elif report.skipped is None:
            state.accumulate_drift()
        return state, report if report.skipped else self.reports.add_drift(state, report)

    def _skip(self, state: GridFastSlamState, pose: Pose, beams: Beams) -> SkipReason | None:
        last = state.sensor_key_poses.get(beams.scan.sensor)
        if last is not None:
            dx, dy, turn = between(last, pose)
            if not self.when_to_update(math.hypot(dx, dy), abs(turn)):
                return SkipReason.BETWEEN_KEY_SCANS
        return None if len(beams) else SkipReason.NO_VALID_BEAM
