"""State and report of Monte Carlo localization."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import Enum
from typing import Annotated, Protocol, final

import numpy as np

from gridslam.arguments import COUNT, SHARE, Limits
from gridslam.geometry.se2 import compose
from gridslam.localization.belief import NO_HYPOTHESES, PoseEstimate, PoseHypotheses, is_in_cluster
from gridslam.localization.odometry_check import TrackedMotion
from gridslam.localization.place_verification import NO_SCANS, RecentScans
from gridslam.localization.recovery import InlierRatioAverages
from gridslam.types import FloatArray, IntArray, Odometry, OwnedState, describe_pose, describe_time


class LocalizationSkip(Enum):
    """Why a scan did not update the particles."""

    MOVED_TOO_LITTLE = "moved too little since the last update"
    NO_VALID_BEAM = "no valid beam"
    NO_ODOMETRY = "no odometry"


@final
@dataclass(frozen=True, slots=True, eq=False)
class LocalizationReport:
    """Report of one step.

    Attributes
    ----------
    stamp_ns : int
        Stamp of the scan.
    pose, covariance : (3,), (3, 3) float64
        Of the robot's base in the map: where the scan fits best, given the densest cluster of particles (see
        `MonteCarloConfiguration.matcher`). The covariance is that cluster's; where the robot is lost, it spans all
        places where it may be.
    lost_probability : float, [0, 1]
        How probable it is that the robot is farther from `pose` than 1 m or 0.5 rad.
    lost : bool
        Whether the lost probability exceeds `MonteCarloConfiguration.lost_above`.
    looking : bool
        Whether the robot is lost because its pose was unknown at first, and has not been found since.
    inlier_ratio : float, [0, 1]
        Inlier ratio with the map at the last update, at the cluster's mean.
    particles : int
        Number of particles after the step.
    n_eff : float
        Effective sample size before resampling; NaN for a scan that was skipped.
    skipped : LocalizationSkip or None
        Why the particles were not updated; None where they were.
    odometry_rejected : bool
        Whether scans contradict the odometry since the last update, and their own motion was used.
    injection_ratio : float, [0, 1]
        Ratio of the belief that was sampled over the whole map; 1 if the pose is unknown.
    poses, log_weights : (N, 3), (N,) float64 or None
        The particles where they were updated, before resampling; log weights are normalized.
    parents : (M,) int64 or None
        For each particle after the step the index of the one that it continues; None where nothing was resampled.
    """

    stamp_ns: int
    pose: FloatArray
    covariance: FloatArray
    lost_probability: float
    lost: bool
    inlier_ratio: float
    particles: int
    n_eff: float = float("nan")
    skipped: LocalizationSkip | None = None
    odometry_rejected: bool = False
    injection_ratio: float = 0.0
    looking: bool = False
    poses: FloatArray | None = None
    log_weights: FloatArray | None = None
    parents: IntArray | None = None

    def __repr__(self) -> str:
        """Return one line."""
        what = f"{self.particles} particles" if self.skipped is None else self.skipped.value
        lost = ", lost" if self.lost else ""
        return f"LocalizationReport({describe_time(self.stamp_ns)}: {describe_pose(self.pose)}, {what}{lost})"


_ELSEWHERE_M = 3.0
"""A place that is nearer to the one before is as much inside the map as that was: the odometry may be wrong."""


@final
@dataclass(slots=True, eq=False)
class MonteCarloState(OwnedState):
    """Everything that the filter knows between two scans; arrays in it are replaced, those of local maps written to.

    Attributes
    ----------
    poses, log_weights : (N, 3), (N,) float64
        The particles at the last update, map frame, normalized; none where nothing is known.
    averages : InlierRatioAverages
        How well scans fitted, lately and for long.
    estimate : PoseEstimate
        Pose estimate from the particles at the last update.
    driven_since_found_m : float, m
        Path length since the reported place was found on which the odometry was not rejected; infinite if it was given.
    hypotheses : PoseHypotheses
        Places without particles that no scan has refuted yet.
    recent : RecentScans
        The scans of the last updates, back to where a place was found among particles drawn from all over the map.
    verified : bool
        Whether the reported place was verified, or given.
    outside_log_odds : float or None
        Log odds that the robot is outside what is mapped against being at the reported place; None where it is not
        computed for that place yet.
    inlier_ratio : float, [0, 1]
        Inlier ratio with the map there.
    odometry : (3,) float64 or None
        Odometry's pose at the last update; None before the first one.
    last : Odometry or None
        Of the last scan.
    updates : int
        How many there were.
    looking : bool
        Whether the pose was unknown at first, and has not been found since.
    tracked : TrackedMotion or None
        Motion from scan to scan, by which the odometry is checked; None before the first scan, and without a check.
    """

    poses: Annotated[FloatArray, "N", 3]
    log_weights: Annotated[FloatArray, "N"]
    averages: InlierRatioAverages
    estimate: PoseEstimate
    driven_since_found_m: float = 0.0
    hypotheses: PoseHypotheses = NO_HYPOTHESES
    recent: RecentScans = NO_SCANS
    verified: bool = False
    outside_log_odds: float | None = None
    inlier_ratio: Annotated[float, SHARE] = 0.0
    odometry: Annotated[FloatArray, 3, Limits(-1e9, 1e9)] | None = None
    last: Odometry | None = None
    updates: Annotated[int, COUNT] = 0
    looking: bool = False
    tracked: TrackedMotion | None = None

    def __repr__(self) -> str:
        """Return one line."""
        if self.consumed:
            return "MonteCarloState(consumed)"
        at = f"the robot at {describe_pose(self.estimate.pose)}" if len(self.poses) else "nothing known"
        return f"MonteCarloState({len(self.poses)} particles, {at}, {self.updates} updates)"

    @property
    def odometry_rejected(self) -> bool:
        """Whether scans contradict the odometry since the last update."""
        return self.tracked is not None and self.tracked.replaces_odometry

    def odometry_at_update(self, first: Odometry) -> FloatArray:
        """Odometry's pose (3,) at the last update; that of the `first` scan with odometry before there was any."""
        if self.odometry is None:
            self.odometry = first.pose
        return self.odometry

    def advance(self, poses: FloatArray, log_weights: FloatArray, odometry: Odometry | None) -> None:
        """Take the particles (N, 3) of an update and their normalized log weights (N,)."""
        assert odometry is not None  # an update needs it
        self.poses = poses
        self.log_weights = log_weights
        self.odometry = odometry.pose
        self.last = odometry
        self.updates += 1
        if self.tracked is not None:
            self.tracked = self.tracked._replace(pose_at_update=self.tracked.tracker.pose)

    def add_particles(self, poses: FloatArray, log_weights: FloatArray) -> None:
        """Mix particles (K, 3) into the belief of which they are a part by their log weights (K,)."""
        if len(poses):
            rest = math.log1p(-min(float(np.exp(log_weights).sum()), 1.0 - 1e-9))
            self.poses = np.concatenate([self.poses, poses])
            self.log_weights = np.concatenate([self.log_weights + rest, log_weights])

    def update_estimate(self, estimate: PoseEstimate, moved: FloatArray) -> None:
        """Update the estimate after the robot has `moved` (3,): the same place, or another one.

        Motion that odometry and scans do not agree on confirms no place: it may be the laser that is mirrored.
        """
        same = is_in_cluster(compose(self.estimate.pose, moved)[None], estimate.pose)[0]
        confirms_m = 0.0 if self.odometry_rejected else math.hypot(moved[0], moved[1])
        self.driven_since_found_m = self.driven_since_found_m + confirms_m if same else 0.0
        self.verified = self.verified and bool(same)
        jumped = estimate.pose[:2] - self.estimate.pose[:2]
        if not same and math.hypot(jumped[0], jumped[1]) > _ELSEWHERE_M:
            self.outside_log_odds = None
        self.estimate = estimate

    def note_found(self, report: LocalizationReport) -> LocalizationReport:
        """Note whether the robot has been found; return the report with whether it is still looked for."""
        self.looking = self.looking and report.lost
        return replace(report, looking=self.looking)

    def resample(self, parents: IntArray) -> None:
        """Let particle i continue particle parents[i] of parents (M,), all with equal weights."""
        self.poses = self.poses.take(parents, axis=0)
        self.log_weights = np.full(len(parents), -np.log(len(parents)))

    def revive(self) -> None:
        """Undo a step that failed: the state is as before it, except that the tracker may have followed the scan."""
        self.consumed = False

    def snapshot(self) -> MonteCarloState:
        """Keep this state for later, at the cost of the tables of the tracker's local maps."""
        self.require_owned()
        return replace(self, tracked=None if self.tracked is None else self.tracked.snapshot())


class LocalizationObserver(Protocol):
    """Sees every scan's report; recorders, live pages and publishers are observers."""

    def __call__(self, report: LocalizationReport, state: MonteCarloState, seconds: float) -> None:
        """Record a step that took `seconds`; `state` may be read now, but belongs to the filter."""
