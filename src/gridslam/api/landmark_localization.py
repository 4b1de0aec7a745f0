"""From a log of landmarks and a map of them to a trajectory: EKF localization, and the result with its output files."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, final

import numpy as np
from numpy.typing import ArrayLike

from gridslam.api.landmarks import COMMANDS, MOTION, SENSORS, ResultByLandmarks, align_trajectory, run_steps
from gridslam.api.result import write_trajectory
from gridslam.checked import checked
from gridslam.errors import ArgumentError, InputError
from gridslam.evaluation.trajectory import PoseErrors, absolute_errors, interpolate
from gridslam.geometry.se2 import compose, inverse
from gridslam.io.landmark_logs import LandmarkLog, open_landmark_log_if_path
from gridslam.io.landmarks import read_landmarks
from gridslam.io.output import OutputFolder
from gridslam.io.text import compute_digest
from gridslam.localization.ekf import EkfLocalization, EkfLocalizationReport, KnownLandmarks
from gridslam.models.association import KnownCorrespondence, MaximumLikelihood
from gridslam.models.landmark import LandmarkModel, LandmarkStep
from gridslam.models.systematic_errors import SystematicErrors
from gridslam.pipeline import Stopwatch
from gridslam.types import FloatArray, MotionModel, Trajectory
from gridslam.viz import draw_landmarks
from gridslam.viz.notebook import Picture

_COMPLETE_MAP_GATES = MaximumLikelihood(match_gate=100.0, new_gate=100.0)
"""In a complete map an observation far off indicates a wrong pose rather than a new landmark.

On MRCLAM a gate of 3 standard deviations loses robot 3 where it sees nothing for 24 s; 5 to 10 do not.
"""

_NEAR = np.diag([0.1**2, 0.1**2, 0.1**2])
"""Default covariance of the initial pose: 10 cm and 6 degrees, as for a robot placed on a mark."""


@final
@dataclass(frozen=True, slots=True, eq=False, repr=False, kw_only=True)
class LandmarkLocalizationResult(ResultByLandmarks):
    """Online trajectory of the robot in a known landmark map.

    Attributes
    ----------
    reports : sequence of EkfLocalizationReport
        One for each step.
    landmarks : KnownLandmarks
        The map.
    landmarks_path : Path or None
        Where it was read, unless it is the truth or was given as such.
    in_true_frame : bool
        Whether the map is that of the true landmarks: then errors are computed without alignment.
    """

    schema: ClassVar = "gridslam.landmark_localization/2"

    reports: Sequence[EkfLocalizationReport]
    landmarks: KnownLandmarks
    landmarks_path: Path | None
    in_true_frame: bool

    @property
    def trajectory(self) -> Trajectory:
        """A pose for each step, in the frame of the landmarks."""
        return Trajectory(self.stamps_ns, np.array([report.pose for report in self.reports]))

    @property
    def covariances(self) -> FloatArray:
        """Covariance (T, 3, 3) of each."""
        return np.array([report.covariance for report in self.reports])

    @property
    def outliers(self) -> int:
        """Number of outlier observations."""
        return sum(int((report.landmarks < 0).sum()) for report in self.reports)

    def errors(self) -> PoseErrors | None:
        """Errors against the truth, after alignment unless the map is in its frame; None where it is not known."""
        compared = self.compare()
        if compared is None:
            return None
        return absolute_errors(*compared, aligned=not self.in_true_frame, tolerance_ns=0)

    def caption(self) -> list[str]:
        """Return lines that describe the result."""
        lines = [
            f"EKF localization, {self._correspondences()} correspondences",
            f"{len(self.stamps_ns)} steps, {self.log.statistics.observations} observations, "
            f"{len(self.landmarks.names)} known landmarks",
        ]
        errors = self.errors()
        if errors is not None:
            lines.append(f"RMSE: position {errors.trans_rmse_m:.3f} m, heading {errors.rot_rmse_deg:.1f} degrees")
        return [*lines, self._last_line()]

    def picture(self) -> Picture:
        """Draw the trajectory and the landmarks, and the truth where it is known."""
        compared = self.compare()
        truth = None if compared is None else compared[1]
        if compared is not None and truth is not None and not self.in_true_frame:
            truth = Trajectory(truth.stamps_ns, compose(inverse(align_trajectory(*compared)), truth.poses))
        exact = np.zeros((len(self.landmarks.names), 2, 2))
        return draw_landmarks(
            self.trajectory,
            self.landmarks.positions,
            exact,
            title=self.source.name,
            caption=self.caption(),
            truth=truth,
            true_positions=self.landmarks.positions,
            stamped=self.log.stamped,
        )

    def _write_files(self, out: OutputFolder) -> None:
        write_trajectory(out, self.trajectory, self.covariances)

    def _describe(self) -> dict[str, Any]:
        errors = self.errors()
        return {
            "method": "ekf-localization",
            **ResultByLandmarks._describe(self),
            "map": {
                "path": None if self.landmarks_path is None else os.fspath(self.landmarks_path),
                "landmarks": len(self.landmarks.names),
            },
            "outliers": self.outliers,
            "log_likelihood": float(sum(report.log_likelihood for report in self.reports)),
            "errors": None if errors is None else {"aligned": not self.in_true_frame, **asdict(errors)},
        }


@checked
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
        A stopwatch to continue.

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
    known = _read_known(source, landmarks)
    association = _COMPLETE_MAP_GATES if unknown else KnownCorrespondence()
    model = sensor or SENSORS[source.kind]
    watch.lap("start")
    steps = list(source)
    watch.lap("read")
    has_noise = all(step.covariance is not None for step in steps)
    bias = SystematicErrors() if has_noise else COMMANDS
    ekf = EkfLocalization(known, model, association, bias)
    if pose is None:
        pose = _find_start(source, steps) if landmarks is None else np.zeros(3)
    if unknown:
        steps = [replace(step, observations=step.observations.drop_correspondences()) for step in steps]
    _, reports = run_steps(steps, motion, ekf.step, ekf.init(pose, covariance), on_progress)
    watch.lap("solve")
    if not any((report.landmarks >= 0).any() for report in reports):
        raise InputError(source.path, "expected observations of the landmarks in the map, got none that fits")
    return LandmarkLocalizationResult(
        stamps_ns=np.array([step.stamp_ns for step in steps], np.int64),
        unknown=unknown,
        log=source,
        models={"sensor": model, "motion": motion, "association": association, "bias": bias},
        digest=compute_digest(source.path),
        stopwatch=watch,
        reports=tuple(reports),
        landmarks=known,
        landmarks_path=Path(landmarks) if isinstance(landmarks, str | Path) else None,
        in_true_frame=landmarks is None,
    )


def _read_known(log: LandmarkLog, landmarks: str | Path | KnownLandmarks | None) -> KnownLandmarks:
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


def _find_start(log: LandmarkLog, steps: list[LandmarkStep]) -> FloatArray:
    """Read the true pose at the first step, or the one nearest in time."""
    if log.truth is None or log.truth.trajectory is None or not steps:
        raise ArgumentError("pose", "a pose, as the true one is not known", None)
    truth = log.truth.trajectory
    first = np.clip(steps[0].stamp_ns, truth.stamps_ns.min(), truth.stamps_ns.max())
    poses, _ = interpolate(truth, [int(first)])
    return np.asarray(poses[0])
