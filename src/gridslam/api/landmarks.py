"""From a log of landmarks to a trajectory and a map of landmarks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np

from gridslam.api.landmark_models import MOTION, SENSORS, WIDE_MOTION
from gridslam.api.landmark_result import LandmarkEstimate, LandmarkResult
from gridslam.arguments import require_seed
from gridslam.errors import ArgumentError
from gridslam.io.landmark_logs import LandmarkLog, open_landmark_log_if_path
from gridslam.io.text import compute_digest
from gridslam.models.association import AMBIGUOUS, Association, KnownCorrespondence, MaximumLikelihood
from gridslam.models.landmark import LandmarkModel, LandmarkStep
from gridslam.models.motion import EXACT_ODOMETRY, OdometryBias
from gridslam.pipeline import Stopwatch
from gridslam.slam.landmarks.ekf_slam import EkfSlam
from gridslam.slam.landmarks.fastslam1 import FastSlam1
from gridslam.slam.landmarks.fastslam2 import FastSlam2
from gridslam.slam.landmarks.filters import LandmarkFilters
from gridslam.slam.landmarks.graph_slam import LandmarkGraphSlam
from gridslam.slam.landmarks.local_frame import FastSlam2WithLocalFrames
from gridslam.slam.landmarks.odometry_bias import FastSlam2WithOdometryBias
from gridslam.slam.landmarks.particles import smooth_trajectory
from gridslam.slam.landmarks.report import LandmarkReport
from gridslam.slam.pose_graph.cauchy import CauchyEstimator
from gridslam.slam.pose_graph.graph_slam import GraphSlam
from gridslam.types import FloatArray, MotionModel

__all__ = ["METHODS", "PARTICLES", "PARTICLES_UNKNOWN_CORRESPONDENCES", "LandmarkMethod", "map_landmarks"]

LandmarkMethod: TypeAlias = Literal["ekf", "fastslam1", "fastslam2", "graph"]

METHODS: tuple[LandmarkMethod, ...] = "ekf", "fastslam1", "fastslam2", "graph"
"""The algorithms there are."""

PARTICLES = {"fastslam1": 100, "fastslam2": 20}
"""Default number of particles of the methods that use particles."""

PARTICLES_UNKNOWN_CORRESPONDENCES = 200
"""The same where the correspondences are unknown.

After an interval without observations the first one may be of any of several landmarks in any of several directions,
and some particles must be right: of MRCLAM's intervals of 30 s, in a room of 15 barcodes, 20 particles seldom survive
all.
"""

_OUTLIER_WEIGHT = 0.1  # an observation of a smaller weight is regarded as an outlier
_NO_GATE = KnownCorrespondence(gate=1e6)
"""No observation is rejected, not even at the closure of a loop of kilometres that no particle has closed."""
_WIDE_GATE = KnownCorrespondence(gate=50.0)
"""7 standard deviations: once in 10^11 for a true one by a filter that knows how its odometry errs, loops included."""

_BIAS = OdometryBias()


def map_landmarks(
    log: str | Path | LandmarkLog,
    method: LandmarkMethod = "fastslam2",
    *,
    particles: int | None = None,
    seed: int = 0,
    unknown: bool = False,
    sensor: LandmarkModel | None = None,
    motion: MotionModel | None = None,
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
    particles : int, optional
        Of FastSLAM; if not given 100 for 1.0 and 20 for 2.0, and 200 for both where correspondences are unknown.
    seed : int, >= 0
        Of FastSLAM; the same gives identical results.
    unknown : bool
        Ignore the correspondences of the log and estimate them. Not with "graph".
    sensor : LandmarkModel, optional
        Measurement model; if not given, that of the observation type of the log.
    motion : MotionModel, optional
        For a log without odometry covariances; if not given, one for MRCLAM's commands.
    on_progress : callable
        Called after each step.
    stopwatch : Stopwatch, optional
        To go on with.

    Raises
    ------
    ArgumentError
        There is no such method, or an argument is not one for it.
    InputError
        The log cannot be read.
    """
    _check(method, particles, seed, unknown)
    watch = stopwatch or Stopwatch()
    source = open_landmark_log_if_path(log)
    if particles is None and method in PARTICLES:
        particles = PARTICLES_UNKNOWN_CORRESPONDENCES if unknown else PARTICLES[method]
    model, motion = sensor or SENSORS[source.kind], motion or (WIDE_MOTION if unknown else MOTION)
    watch.lap("start")
    steps = list(source)
    watch.lap("read")
    models: dict[str, Any] = {"sensor": model, "motion": motion}
    if method == "graph":
        estimate = _by_graph(steps, model, motion)
    else:
        association: Association = MaximumLikelihood() if unknown else _known_correspondence(steps, method)
        shown = _drop_correspondences(steps) if unknown else steps
        if method == "ekf":
            models["bias"] = EXACT_ODOMETRY if unknown else _BIAS
            estimate = _by_ekf(shown, EkfSlam(model, association, bias=models["bias"]), motion, on_progress)
        else:
            slam, bias = _particle_filter(method, LandmarkFilters(model, association), _has_own_noise(steps))
            models |= {"bias": bias} if method == "fastslam2" else {}
            estimate = _by_particles(shown, slam, bias, particles or 0, seed, motion, on_progress)
    watch.lap("solve")
    return LandmarkResult(
        method=method, estimate=estimate, unknown=unknown, seed=seed, log=source, stopwatch=watch,
        stamps_ns=np.array([step.stamp_ns for step in steps], np.int64),
        particles=particles, models=models, digest=compute_digest(source.path),
    )  # fmt: skip


def _by_ekf(
    steps: Sequence[LandmarkStep], slam: EkfSlam, motion: MotionModel, on_progress: Callable[[], None]
) -> LandmarkEstimate:
    state, reports = slam.init(), list[LandmarkReport]()
    for step in steps:
        state, report = slam.step(state, step.motion(motion), step.observations)
        reports.append(report)
        on_progress()
    online = _poses(reports)
    return LandmarkEstimate(
        online, online, _covariances(reports), slam.landmark_map(state), _count_outliers(reports), {}
    )


def _by_particles(
    steps: Sequence[LandmarkStep], slam: FastSlam1 | FastSlam2, bias: OdometryBias, particles: int, seed: int,
    motion: MotionModel, on_progress: Callable[[], None],
) -> LandmarkEstimate:  # fmt: skip
    rng, state, reports = np.random.default_rng(seed), slam.init(particles), list[LandmarkReport]()
    for step in steps:
        state, report = slam.step(state, step.motion(motion), step.observations, rng)
        reports.append(report)
        on_progress()
    figures = {
        "n_eff_mean": float(np.mean([report.n_eff for report in reports])),
        "resamplings": sum(report.parents is not None for report in reports),
    }
    full = smooth_trajectory(state, state.best, [step.motion(motion) for step in steps], bias)[1:]
    landmarks = slam.landmark_map(state)
    return LandmarkEstimate(full, _poses(reports), _covariances(reports), landmarks, _count_outliers(reports), figures)


def _by_graph(steps: Sequence[LandmarkStep], sensor: LandmarkModel, motion: MotionModel) -> LandmarkEstimate:
    robust = None if _has_own_noise(steps) else CauchyEstimator()
    found = LandmarkGraphSlam(sensor, GraphSlam(first_guess="given", robust=robust)).solve(steps, motion)
    figures = {
        "chi2": found.solution.chi2_after,
        "degrees_of_freedom": found.degrees_of_freedom,
        "converged": found.solution.converged,
    }
    outliers = int((found.solution.weights < _OUTLIER_WEIGHT).sum())
    return LandmarkEstimate(found.poses, None, found.covariances, found.landmarks, outliers, figures)


def _drop_correspondences(steps: Sequence[LandmarkStep]) -> list[LandmarkStep]:
    return [replace(step, observations=step.observations.drop_correspondences()) for step in steps]


def _has_own_noise(steps: Sequence[LandmarkStep]) -> bool:
    """Whether a log contains measurement covariances; only then its correspondences are trusted without a gate."""
    return all(step.covariance is not None for step in steps)


def _known_correspondence(steps: Sequence[LandmarkStep], method: LandmarkMethod) -> KnownCorrespondence:
    if not _has_own_noise(steps):
        return KnownCorrespondence()
    return _WIDE_GATE if method == "ekf" else _NO_GATE


def _particle_filter(
    method: LandmarkMethod, landmarks: LandmarkFilters, told: bool
) -> tuple[FastSlam1 | FastSlam2, OdometryBias]:
    """Choose the filter, and the errors of the odometry that it learns: of 2.0 the variant that suits the log."""
    if method == "fastslam1":
        return FastSlam1(landmarks), EXACT_ODOMETRY
    if told:
        return FastSlam2WithOdometryBias(landmarks, bias=_BIAS), _BIAS
    return FastSlam2WithLocalFrames(landmarks), EXACT_ODOMETRY


def _poses(reports: Sequence[LandmarkReport]) -> FloatArray:
    return np.array([report.pose for report in reports])


def _covariances(reports: Sequence[LandmarkReport]) -> FloatArray:
    return np.array([report.covariance for report in reports])


def _count_outliers(reports: Sequence[LandmarkReport]) -> int:
    return sum(int((report.landmarks == AMBIGUOUS).sum()) for report in reports)


def _check(method: str, particles: int | None, seed: int, unknown: bool) -> None:
    if method not in METHODS:
        raise ArgumentError("method", f"one of {', '.join(METHODS)}", method)
    if particles is not None and (particles < 1 or method not in PARTICLES):
        raise ArgumentError("particles", "at least one, for FastSLAM only", f"{particles} for {method}")
    require_seed(seed)
    if unknown and method == "graph":
        raise ArgumentError("unknown", "False for the graph, which needs known correspondences", unknown)
