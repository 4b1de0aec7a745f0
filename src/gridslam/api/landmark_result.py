"""Result of mapping landmarks, and its output files."""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, final

from gridslam import __version__
from gridslam.api.showing import describe_result, tabulate
from gridslam.evaluation.landmarks import LandmarkErrors, landmark_errors, pair_by_name, pair_by_position
from gridslam.evaluation.trajectory import PoseErrors, absolute_errors, align, clip_to_truth
from gridslam.geometry.se2 import compose, inverse, transform_points
from gridslam.io.landmark_logs import LandmarkLog
from gridslam.io.landmarks import write_landmarks
from gridslam.io.output import OutputFolder
from gridslam.io.trajectories import write_trajectory_csv, write_tum
from gridslam.pipeline import Stopwatch
from gridslam.slam.landmarks.report import LandmarkMap
from gridslam.types import FloatArray, IntArray, Trajectory

if TYPE_CHECKING:
    from pandas import DataFrame

    from gridslam.viz.notebook import Picture

__all__ = ["LANDMARKS_SCHEMA", "LandmarkEstimate", "LandmarkResult"]

LANDMARKS_SCHEMA = "gridslam.landmarks/2"


class LandmarkEstimate(NamedTuple):
    """Estimate of a landmark algorithm.

    Attributes
    ----------
    poses : (T, 3) float64
        After each step: smoothed, by all methods except EKF SLAM, which marginalizes the past.
    online : (T, 3) float64 or None
        Online estimates, by filters.
    covariances : (T, 3, 3) float64
        Of the poses: online by filters, of the final solution by the graph.
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


@final
@dataclass(frozen=True, slots=True, eq=False)
class LandmarkResult:
    """Trajectory and landmark map of a log.

    Attributes
    ----------
    method : str
    stamps_ns : (T,) int64, ns
        Of the steps.
    estimate : LandmarkEstimate
    unknown : bool
        Whether the correspondences were to be found.
    particles : int or None
    seed : int
    log : LandmarkLog
    models : dict
        Measurement and motion model.
    digest : str
        SHA-256 of the log's file.
    stopwatch : Stopwatch
        Time spent; saving goes on counting.
    """

    method: str
    stamps_ns: IntArray
    estimate: LandmarkEstimate
    unknown: bool
    particles: int | None
    seed: int
    log: LandmarkLog
    models: dict[str, Any]
    digest: str
    stopwatch: Stopwatch

    @property
    def trajectory(self) -> Trajectory:
        """A pose for each step, map frame."""
        return Trajectory(self.stamps_ns, self.estimate.poses)

    @property
    def landmarks(self) -> LandmarkMap:
        """The landmarks, map frame."""
        return self.estimate.landmarks

    def errors(self) -> tuple[PoseErrors | None, LandmarkErrors | None]:
        """Errors against the truth, after alignment of the trajectory and of the landmarks, each by itself."""
        compared = self._compared()
        poses = None if compared is None else absolute_errors(*compared, tolerance_ns=0)
        if self.log.truth is None or (pairs := self._pairs(compared)) is None:
            return poses, None
        return poses, landmark_errors(self.landmarks.positions, self.log.truth.positions, pairs)

    def save(self, folder: str | Path) -> dict[str, Any]:
        """Write all results into a folder, all or none; returns the content of run.json."""
        with OutputFolder(folder) as out:
            return self.write(out)

    def write(self, out: OutputFolder) -> dict[str, Any]:
        """Write all results into an open output folder; returns the content of run.json."""
        self.stopwatch.resume()
        write_tum(out.file("trajectory.tum"), self.trajectory)
        write_trajectory_csv(out.file("trajectory.csv"), self.trajectory, self.estimate.covariances)
        if self.estimate.online is not None:
            write_tum(out.file("trajectory_online.tum"), Trajectory(self.stamps_ns, self.estimate.online))
        write_landmarks(out.file("landmarks.csv"), self.landmarks)
        self.stopwatch.lap("write")
        self.picture().save(out.file("landmarks.png"), optimize=False)
        self.stopwatch.lap("draw")
        document = self._document()
        out.write_json("run.json", document)
        return document

    def _document(self) -> dict[str, Any]:
        """Build the content of run.json."""
        counts = self.log.statistics
        statistics = {**asdict(counts), "duration_s": counts.duration_s, "stamped": self.log.stamped}
        poses, landmarks = self.errors()
        return {
            "schema": LANDMARKS_SCHEMA,
            "version": __version__,
            "method": self.method,
            "correspondences": "unknown" if self.unknown else "known",
            "particles": self.particles,
            "seed": self.seed,
            "input": {"path": os.fspath(self.log.path), "sha256": self.digest, **statistics},
            "landmarks": len(self.landmarks),
            "outliers": self.estimate.outliers,
            **self.estimate.figures,
            "errors": {
                "trajectory": None if poses is None else asdict(poses),
                "landmarks": None if landmarks is None else asdict(landmarks),
            },
            "models": {name: {"kind": type(model).__name__, **asdict(model)} for name, model in self.models.items()},
            "time": self.stopwatch.to_dict(),
        }

    def caption(self) -> list[str]:
        """Lines that describe the result."""
        known = "unknown" if self.unknown else "known"
        particles = f", {self.particles} particles, seed {self.seed}" if self.particles else ""
        observations = self.log.statistics.observations
        poses, landmarks = self.errors()
        lines = [
            f"{self.method}, {known} correspondences{particles}",
            f"{len(self.stamps_ns)} steps, {observations} observations, {len(self.landmarks)} landmarks",
        ]
        if poses is not None and landmarks is not None:
            lines.append(f"RMSE: position {poses.trans_rmse_m:.3f} m, landmarks {landmarks.rmse_m:.3f} m")
        return [*lines, f"{self.stopwatch.stages['solve'][0]:.1f} s: gridslam {__version__}"]

    def to_dataframe(self) -> DataFrame:
        """Return a pandas.DataFrame with a row for each step: stamp_ns and the columns of trajectory.csv.

        Raises
        ------
        MissingDependencyError
            pandas is not installed; the extra ``pandas`` brings it.
        """
        return tabulate(self.trajectory, self.estimate.covariances)

    def __repr__(self) -> str:
        """Return one line."""
        return describe_result(self, self.log.path.name, self.caption())

    def _repr_png_(self) -> bytes:
        from gridslam.viz.notebook import encode_png

        return encode_png(self.picture())

    def _compared(self) -> tuple[Trajectory, Trajectory] | None:
        """The steps that the truth covers, and the truth at them."""
        if self.log.truth is None or (known := self.log.truth.trajectory) is None:
            return None
        return clip_to_truth(self.trajectory, known)

    def _pairs(self, compared: tuple[Trajectory, Trajectory] | None) -> tuple[IntArray, IntArray] | None:
        """Partners among the landmarks and the true ones; None where there is none."""
        known = self.log.truth
        assert known is not None
        if not self.unknown:
            pairs = pair_by_name(self.landmarks.names, known.landmarks)
        elif compared is None:
            return None
        else:
            pairs = pair_by_position(self.landmarks.positions, known.positions, _true_from_map(*compared))
        return pairs if len(pairs[0]) else None

    def picture(self) -> Picture:
        """Draw the trajectory and the landmarks, and the truth where it is known."""
        from gridslam.viz.landmark_picture import draw_landmarks  # only drawing pays for the import of Pillow

        compared, known, way, points = self._compared(), self.log.truth, None, None
        if compared is not None and known is not None:
            truth, map_from_true = compared[1], inverse(_true_from_map(*compared))
            way = Trajectory(truth.stamps_ns, compose(map_from_true, truth.poses))
            points = transform_points(map_from_true, known.positions)
        return draw_landmarks(
            self.trajectory, self.landmarks.positions, self.landmarks.covariances, title=self.log.path.name,
            caption=self.caption(), truth=way, true_positions=points, stamped=self.log.stamped,
        )  # fmt: skip


def _true_from_map(found: Trajectory, truth: Trajectory) -> FloatArray:
    return align(found.poses[:, :2], truth.poses[:, :2])
