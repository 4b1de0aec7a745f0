"""From a log of landmarks to a trajectory and a map of landmarks, and the result with its output files."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, Final, Literal, NamedTuple, TypeAlias, TypeVar, final

import numpy as np

from gridslam import __version__
from gridslam.api.result import Result, write_trajectory
from gridslam.arguments import require_seed
from gridslam.checked import checked
from gridslam.errors import ArgumentError
from gridslam.evaluation.maps import LandmarkErrors, landmark_errors, pair_by_name, pair_by_position
from gridslam.evaluation.trajectory import PoseErrors, absolute_errors, align, clip_to_truth
from gridslam.geometry.se2 import compose, inverse, transform_points
from gridslam.io.landmark_logs import LandmarkLog, open_landmark_log_if_path
from gridslam.io.landmarks import write_landmarks
from gridslam.io.output import OutputFolder
from gridslam.io.text import compute_digest
from gridslam.io.trajectories import write_tum
from gridslam.models.association import (
    AMBIGUOUS,
    Association,
    KnownCorrespondence,
    MaximumLikelihood,
)
from gridslam.models.landmark import (
    DepthBearing,
    LandmarkModel,
    LandmarkObservations,
    LandmarkStep,
    ObservationKind,
    RangeBearing,
    RelativePosition,
)
from gridslam.models.motion import DiffusionMotion
from gridslam.models.systematic_errors import ERROR_NAMES, SystematicErrors
from gridslam.pipeline import Stopwatch
from gridslam.slam.landmarks.calibration import calibrate_odometry
from gridslam.slam.landmarks.ekf_slam import EkfSlam
from gridslam.slam.landmarks.fastslam1 import FastSlam1
from gridslam.slam.landmarks.fastslam2 import FastSlam2
from gridslam.slam.landmarks.filters import LandmarkFilters
from gridslam.slam.landmarks.graph_slam import LandmarkGraphSlam
from gridslam.slam.landmarks.report import LandmarkMap, LandmarkReport
from gridslam.slam.pose_graph.graph_slam import GraphSlam
from gridslam.slam.pose_graph.robust import CauchyEstimator
from gridslam.types import FloatArray, IntArray, MotionModel, MotionSampler, Trajectory
from gridslam.viz import draw_landmarks
from gridslam.viz.notebook import Picture

LandmarkMethod: TypeAlias = Literal["ekf", "fastslam1", "fastslam2", "graph"]

METHODS: tuple[LandmarkMethod, ...] = "ekf", "fastslam1", "fastslam2", "graph"
"""The algorithms there are."""

PARTICLES = {"fastslam1": 100, "fastslam2": 20}
"""Default number of particles of the methods that use particles."""

_PARTICLES_UNKNOWN = 200
"""The same with unknown correspondences, of which each particle holds others.

After an interval without observations the first one may be of any of several landmarks in any of several directions,
and some particles must be right: of MRCLAM's intervals of 30 s, in a room of 15 barcodes, 20 seldom survive all.
"""

_OUTLIER_WEIGHT = 0.1  # an observation of a smaller weight is regarded as an outlier
SENSORS: Final[dict[ObservationKind, LandmarkModel]] = {
    ObservationKind.RANGE_BEARING: RangeBearing(),
    ObservationKind.DEPTH_BEARING: DepthBearing(),
    ObservationKind.POSITION: RelativePosition(),
}
"""Measurement model of each observation type."""

MOTION: Final = DiffusionMotion(sigma_xy_m=0.05, sigma_theta_rad=0.08)
"""Errors of MRCLAM's commands per metre or radian, the systematic ones included; logs with covariances do not need it.
"""

COMMANDS: Final = SystematicErrors(
    sigma_per_m=0.05, sigma_per_rad=0.05, sigma_odometry_scale=0.05, sigma_mounting_m=0.05, sigma_range_scale=0.03
)
"""Systematic errors of a log without covariances: commands instead of odometry, and a camera instead of a laser.

A controller holds the speed of a wheel to about a percent, and two wheels 0.26 m apart of which one is 1.3 % faster
turn by 0.05 rad per metre; tread and tyres make the rest. A monocular camera's depths are as good as its focal
length and the height of a printed mark: some percent.
"""

_State = TypeVar("_State")
_Report = TypeVar("_Report")

_NO_GATE = KnownCorrespondence(gate=1e6)
"""No observation is rejected: not even where FastSLAM closes a loop of kilometres that no particle has closed yet."""


class LandmarkEstimate(NamedTuple):
    """Estimate of a landmark algorithm.

    Attributes
    ----------
    poses : (T, 3) float64
        After each step: of the best particle's path, of the graph, or online by EKF SLAM, which marginalizes the past.
    online : (T, 3) float64 or None
        Online estimates, by filters.
    covariances : (T, 3, 3) float64
        Of the poses: of the filter's, or of the final solution by the graph.
    landmarks : LandmarkMap
    outliers : int
        Number of outlier observations.
    figures : dict
        Other results of the method, as JSON values.
    """

    poses: FloatArray
    online: FloatArray | None
    covariances: FloatArray
    landmarks: LandmarkMap
    outliers: int
    figures: dict[str, Any]


@dataclass(frozen=True, slots=True, eq=False, repr=False, kw_only=True)
class ResultByLandmarks(Result):
    """Base of the results of landmark mapping and landmark localization.

    Attributes
    ----------
    stamps_ns : (T,) int64, ns
        Of the steps.
    unknown : bool
        Whether the correspondences were to be found.
    log : LandmarkLog
    models : dict
        Measurement and motion model, and what else the method has.
    digest : str
        SHA-256 of the log's file.
    """

    picture_name: ClassVar = "landmarks.png"
    file_names: ClassVar = ("trajectory.tum", "trajectory.csv", "trajectory_online.tum", "landmarks.csv")

    stamps_ns: IntArray
    unknown: bool
    log: LandmarkLog
    models: dict[str, Any]
    digest: str

    @property
    def source(self) -> Path:
        """The log's file."""
        return self.log.path

    def compare(self) -> tuple[Trajectory, Trajectory] | None:
        """Return the trajectory where the truth covers it, and the truth at its steps; None where there is none."""
        if self.log.truth is None or self.log.truth.trajectory is None:
            return None
        return clip_to_truth(self.trajectory, self.log.truth.trajectory)

    def _correspondences(self) -> str:
        return "unknown" if self.unknown else "known"

    def _last_line(self) -> str:
        return f"{self.stopwatch.stages['solve'][0]:.1f} s: gridslam {__version__}"

    def _describe(self) -> dict[str, Any]:
        counts = self.log.statistics
        return {
            "correspondences": self._correspondences(),
            "input": {
                "path": os.fspath(self.source),
                "sha256": self.digest,
                **asdict(counts),
                "duration_s": counts.duration_s,
                "stamped": self.log.stamped,
            },
            "models": {name: {"kind": type(model).__name__, **asdict(model)} for name, model in self.models.items()},
        }


@final
@dataclass(frozen=True, slots=True, eq=False, repr=False, kw_only=True)
class LandmarkResult(ResultByLandmarks):
    """Trajectory and landmark map of a log.

    Attributes
    ----------
    method : str
    estimate : LandmarkEstimate
    particles : int or None
    seed : int
    """

    schema: ClassVar = "gridslam.landmarks/2"

    method: str
    estimate: LandmarkEstimate
    particles: int | None
    seed: int

    @property
    def trajectory(self) -> Trajectory:
        """A pose for each step, map frame."""
        return Trajectory(self.stamps_ns, self.estimate.poses)

    @property
    def covariances(self) -> FloatArray:
        """Covariances (T, 3, 3) of the poses."""
        return self.estimate.covariances

    @property
    def landmarks(self) -> LandmarkMap:
        """The landmarks, map frame."""
        return self.estimate.landmarks

    def errors(self) -> tuple[PoseErrors | None, LandmarkErrors | None]:
        """Return errors against the truth, after alignment of the trajectory and of the landmarks, each by itself."""
        compared = self.compare()
        poses = None if compared is None else absolute_errors(*compared, tolerance_ns=0)
        known = self.log.truth
        if known is None or (self.unknown and compared is None):
            return poses, None
        if not self.unknown or compared is None:
            pairs = pair_by_name(self.landmarks.names, known.landmarks)
        else:
            pairs = pair_by_position(self.landmarks.positions, known.positions, align_trajectory(*compared))
        found = landmark_errors(self.landmarks.positions, known.positions, pairs) if len(pairs[0]) else None
        return poses, found

    def caption(self) -> list[str]:
        """Return lines that describe the result."""
        particles = f", {self.particles} particles, seed {self.seed}" if self.particles else ""
        observations = self.log.statistics.observations
        lines = [
            f"{self.method}, {self._correspondences()} correspondences{particles}",
            f"{len(self.stamps_ns)} steps, {observations} observations, {len(self.landmarks)} landmarks",
        ]
        poses, landmarks = self.errors()
        if poses is not None and landmarks is not None:
            lines.append(f"RMSE: position {poses.trans_rmse_m:.3f} m, landmarks {landmarks.rmse_m:.3f} m")
        return [*lines, self._last_line()]

    def picture(self) -> Picture:
        """Draw the trajectory and the landmarks, and the truth where it is known."""
        way = points = None
        compared = self.compare()
        known = self.log.truth
        if compared is not None and known is not None:
            map_from_true = inverse(align_trajectory(*compared))
            way = Trajectory(compared[1].stamps_ns, compose(map_from_true, compared[1].poses))
            points = transform_points(map_from_true, known.positions)
        return draw_landmarks(
            self.trajectory,
            self.landmarks.positions,
            self.landmarks.covariances,
            title=self.source.name,
            caption=self.caption(),
            truth=way,
            true_positions=points,
            stamped=self.log.stamped,
        )

    def _write_files(self, out: OutputFolder) -> None:
        write_trajectory(out, self.trajectory, self.covariances)
        if self.estimate.online is not None:
            write_tum(out.file("trajectory_online.tum"), Trajectory(self.stamps_ns, self.estimate.online))
        write_landmarks(out.file("landmarks.csv"), self.landmarks)

    def _describe(self) -> dict[str, Any]:
        poses, landmarks = self.errors()
        return {
            "method": self.method,
            "particles": self.particles,
            "seed": self.seed,
            **ResultByLandmarks._describe(self),
            "landmarks": len(self.landmarks),
            "outliers": self.estimate.outliers,
            **self.estimate.figures,
            "errors": {
                "trajectory": None if poses is None else asdict(poses),
                "landmarks": None if landmarks is None else asdict(landmarks),
            },
        }


def align_trajectory(found: Trajectory, truth: Trajectory) -> FloatArray:
    """Return pose `true_from_map` (3,) that aligns a trajectory with the true one, pose by pose."""
    return align(found.poses[:, :2], truth.poses[:, :2])


@checked
def map_landmarks(
    log: str | Path | LandmarkLog,
    method: LandmarkMethod = "fastslam2",
    *,
    unknown: bool = False,
    sensor: LandmarkModel | None = None,
    motion: MotionModel | None = None,
    particles: int | None = None,
    seed: int = 0,
    on_progress: Callable[[], None] = lambda: None,
    stopwatch: Stopwatch | None = None,
) -> LandmarkResult:
    """Find the robot's way and the landmarks of a log.

    Parameters
    ----------
    log : str, Path or LandmarkLog
        As `open_landmark_log` knows.
    method : "ekf", "fastslam1", "fastslam2" or "graph"
        EKF SLAM, FastSLAM 1.0 or 2.0, or GraphSLAM.
    unknown : bool
        Ignore the correspondences of the log and estimate them. Not with "graph".
    sensor : LandmarkModel, optional
        Measurement model; if not given, that of the observation type of the log.
    motion : MotionModel, optional
        For a log without odometry covariances; if not given, one for MRCLAM's commands.
    particles : int, optional
        Of FastSLAM; if not given 100 for 1.0 and 20 for 2.0, and 200 with unknown correspondences.
    seed : int, >= 0
        Of FastSLAM; the same gives identical results.
    on_progress : callable
        Called after each step.
    stopwatch : Stopwatch, optional
        A stopwatch to continue.

    Raises
    ------
    ArgumentError
        There is no such method, or an argument is not one for it.
    InputError
        The log cannot be read.
    """
    if method not in METHODS:
        raise ArgumentError("method", f"one of {', '.join(METHODS)}", method)
    if particles is not None and (particles < 1 or method not in PARTICLES):
        raise ArgumentError("particles", "at least one, for FastSLAM only", f"{particles} for {method}")
    require_seed(seed)
    if unknown and method == "graph":
        raise ArgumentError("unknown", "False for the graph, which needs known correspondences", unknown)
    watch = stopwatch or Stopwatch()
    source = open_landmark_log_if_path(log)
    if particles is None:
        particles = _PARTICLES_UNKNOWN if unknown and method in PARTICLES else PARTICLES.get(method)
    model = sensor or SENSORS[source.kind]
    motion = motion or MOTION
    watch.lap("start")
    steps = list(source)
    watch.lap("read")
    has_noise = all(step.covariance is not None for step in steps)
    models: dict[str, Any] = {"sensor": model, "motion": motion}
    association: Association = MaximumLikelihood() if unknown else KnownCorrespondence()
    if method == "graph":
        robust = None if has_noise else CauchyEstimator()  # else observations may be false
        estimate = _solve_graph(steps, LandmarkGraphSlam(model, GraphSlam(first_guess="given", robust=robust)), motion)
    else:
        if unknown:
            steps = [replace(step, observations=step.observations.drop_correspondences()) for step in steps]
        models["bias"] = bias = SystematicErrors() if has_noise else COMMANDS
        ekf = EkfSlam(model, association, bias=bias)
        if method == "ekf":
            estimate = _run_ekf(steps, ekf, motion, on_progress)
        else:
            if has_noise and not unknown:  # else `motion` covers systematic errors, and observations may be false
                steps = calibrate_odometry(steps, ekf, motion)
                association = _NO_GATE
            kind = FastSlam1 if method == "fastslam1" else FastSlam2
            rng = np.random.default_rng(seed)
            estimate = _run_particle_filter(
                steps, kind(LandmarkFilters(model, association)), particles or 0, rng, motion, on_progress
            )
    watch.lap("solve")
    return LandmarkResult(
        stamps_ns=np.array([step.stamp_ns for step in steps], np.int64),
        unknown=unknown,
        log=source,
        models=models,
        digest=compute_digest(source.path),
        stopwatch=watch,
        method=method,
        estimate=estimate,
        particles=particles,
        seed=seed,
    )


def run_steps(
    steps: Sequence[LandmarkStep],
    motion: MotionModel,
    take: Callable[[_State, MotionSampler, LandmarkObservations], tuple[_State, _Report]],
    state: _State,
    on_progress: Callable[[], None],
) -> tuple[_State, list[_Report]]:
    """Run a filter, whose method `step` is `take`, on all steps; return its last state and its reports."""
    reports = []
    for step in steps:
        state, report = take(state, step.motion(motion), step.observations)
        reports.append(report)
        on_progress()
    return state, reports


def _run_ekf(
    steps: Sequence[LandmarkStep], slam: EkfSlam, motion: MotionModel, on_progress: Callable[[], None]
) -> LandmarkEstimate:
    state, reports = run_steps(steps, motion, slam.step, slam.init(), on_progress)
    errors = dict(zip(ERROR_NAMES, state.errors.tolist(), strict=True))
    return _put_together(reports, slam.landmark_map(state))._replace(figures={"systematic_errors": errors})


def _run_particle_filter(
    steps: Sequence[LandmarkStep],
    slam: FastSlam1 | FastSlam2,
    particles: int,
    rng: np.random.Generator,
    motion: MotionModel,
    on_progress: Callable[[], None],
) -> LandmarkEstimate:
    state, reports = run_steps(steps, motion, partial(slam.step, rng=rng), slam.init(particles), on_progress)
    figures = {
        "n_eff_mean": float(np.mean([report.n_eff for report in reports])),
        "resamplings": sum(report.parents is not None for report in reports),
    }
    found = _put_together(reports, slam.landmark_map(state))
    return found._replace(poses=state.ancestry.trajectory(state.best)[1:], figures=figures)


def _put_together(reports: Sequence[LandmarkReport], landmarks: LandmarkMap) -> LandmarkEstimate:
    """Estimate of a filter, of its online poses."""
    online = np.array([report.pose for report in reports])
    covariances = np.array([report.covariance for report in reports])
    outliers = sum(int((report.landmarks == AMBIGUOUS).sum()) for report in reports)
    return LandmarkEstimate(online, online, covariances, landmarks, outliers, {})


def _solve_graph(steps: Sequence[LandmarkStep], slam: LandmarkGraphSlam, motion: MotionModel) -> LandmarkEstimate:
    found = slam.solve(steps, motion)
    figures = {
        "chi2": found.solution.chi2_after,
        "degrees_of_freedom": found.degrees_of_freedom,
        "converged": found.solution.converged,
    }
    outliers = int((found.solution.weights < _OUTLIER_WEIGHT).sum())
    return LandmarkEstimate(found.poses, None, found.covariances, found.landmarks, outliers, figures)
