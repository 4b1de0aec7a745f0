"""From a log of landmarks and a map of them to a trajectory: EKF localization."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from gridslam.api.landmark_localization_result import LandmarkLocalizationResult
from gridslam.api.landmark_models import MOTION, SENSORS
from gridslam.errors import ArgumentError, InputError
from gridslam.evaluation.trajectory import interpolate
from gridslam.io.landmark_logs import LandmarkLog, open_landmark_log_if_path
from gridslam.io.landmarks import read_landmarks
from gridslam.io.text import compute_digest
from gridslam.localization.ekf import EkfLocalization, EkfLocalizationReport, KnownLandmarks
from gridslam.models.association import KnownCorrespondence, MaximumLikelihood
from gridslam.models.landmark import LandmarkModel, LandmarkStep
from gridslam.pipeline import Stopwatch
from gridslam.types import FloatArray, MotionModel

__all__ = ["localize_by_landmarks"]

_COMPLETE_MAP_GATES = MaximumLikelihood(match_gate=100.0, new_gate=100.0)
"""In a complete map an observation far off indicates a wrong pose rather than a new landmark.

On MRCLAM a gate of 3 standard deviations loses robot 3 where it sees nothing for 24 s; 5 to 10 do not.
"""

_NEAR = np.diag([0.1**2, 0.1**2, 0.1**2])
"""Default covariance of the initial pose: 10 cm and 6 degrees, as for a robot placed on a mark."""


def localize_by_landmarks(
    log: str | Path | LandmarkLog,
    landmarks: str | Path | KnownLandmarks | None = None,
    *,
    pose: ArrayLike | None = None,
    covariance: ArrayLike = _NEAR,
    unknown: bool = False,
    sensor: LandmarkModel | None = None,
    motion: MotionModel = MOTION,
    on_progress: Callable[[], None] = lambda: None,
    stopwatch: Stopwatch | None = None,
) -> LandmarkLocalizationResult:
    """Find the robot's way in a map of landmarks that is known, by EKF localization.

    Parameters
    ----------
    log : str, Path or LandmarkLog
        As `open_landmark_log` knows.
    landmarks : str, Path or KnownLandmarks, optional
        The map; a path names a landmarks.csv, as `gridslam landmarks` writes it, whose positions are regarded as exact.
        If not given, the true landmarks of the log.
    pose : (3,), optional
        The robot's pose [x m, y m, theta rad] before the first step, in the frame of the landmarks. If not given it is
        the true pose in the map of the true landmarks, and the origin in any other, for there a map of `gridslam
        landmarks` begins.
    covariance : (3, 3), m and rad
        How well it is known.
    unknown : bool
        Ignore the correspondences of the log and estimate them (Table 7.3).
    sensor : LandmarkModel, optional
        Measurement model; if not given, that of the observation type of the log.
    motion : MotionModel
        For a log without odometry covariances.
    on_progress : callable
        Called after each step.
    stopwatch : Stopwatch, optional
        To go on with.

    Raises
    ------
    ArgumentError
        The pose is none, or its covariance is none.
    InputError
        The log or the landmarks cannot be read, the log has no true landmarks where they are asked for, or it sees none
        of the map.
    """
    watch = stopwatch or Stopwatch()
    source = open_landmark_log_if_path(log)
    known = _known(source, landmarks)
    association = _COMPLETE_MAP_GATES if unknown else KnownCorrespondence()
    model = sensor or SENSORS[source.kind]
    ekf = EkfLocalization(known, model, association)
    watch.lap("start")
    steps = list(source)
    watch.lap("read")
    belief = ekf.init(_start(source, steps, landmarks) if pose is None else pose, covariance)
    reports = list[EkfLocalizationReport]()
    for step in steps:
        seen = step.observations.drop_correspondences() if unknown else step.observations
        belief, report = ekf.step(belief, step.motion(motion), seen)
        reports.append(report)
        on_progress()
    watch.lap("solve")
    if not any((report.landmarks >= 0).any() for report in reports):
        raise InputError(source.path, "expected observations of the landmarks in the map, got none that fits")
    return LandmarkLocalizationResult(
        stamps_ns=np.array([step.stamp_ns for step in steps], np.int64),
        reports=tuple(reports), landmarks=known, unknown=unknown, log=source,
        landmarks_path=Path(landmarks) if isinstance(landmarks, str | Path) else None,
        in_true_frame=landmarks is None, models={"sensor": model, "motion": motion, "association": association},
        digest=compute_digest(source.path), stopwatch=watch,
    )  # fmt: skip


def _known(log: LandmarkLog, landmarks: str | Path | KnownLandmarks | None) -> KnownLandmarks:
    if isinstance(landmarks, KnownLandmarks):
        return landmarks
    if landmarks is None:
        if log.truth is None:
            raise InputError(log.path, "expected true landmarks beside it, as no others are given; got none")
        return KnownLandmarks.of(log.truth.landmarks, log.truth.positions)
    found = read_landmarks(landmarks)
    try:
        return KnownLandmarks.of(found.names, found.positions)
    except ArgumentError as error:
        raise InputError(landmarks, str(error)) from None


def _start(log: LandmarkLog, steps: list[LandmarkStep], landmarks: str | Path | KnownLandmarks | None) -> FloatArray:
    """Default initial pose."""
    if landmarks is not None:
        return np.zeros(3)
    if log.truth is None or log.truth.trajectory is None or not steps:
        raise ArgumentError("pose", "a pose, as the true one is not known", None)
    truth = log.truth.trajectory
    first = np.clip(steps[0].stamp_ns, truth.stamps_ns.min(), truth.stamps_ns.max())
    poses, _ = interpolate(truth, [int(first)])
    return np.asarray(poses[0])
