"""Result of localization in a landmark map, and its output files."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

import numpy as np

from gridslam import __version__
from gridslam.api.showing import describe_result, tabulate
from gridslam.evaluation.trajectory import PoseErrors, absolute_errors, align, clip_to_truth
from gridslam.geometry.se2 import compose, inverse
from gridslam.io.landmark_logs import LandmarkLog
from gridslam.io.output import OutputFolder
from gridslam.io.trajectories import write_trajectory_csv, write_tum
from gridslam.localization.ekf import EkfLocalizationReport, KnownLandmarks
from gridslam.pipeline import Stopwatch
from gridslam.types import FloatArray, IntArray, Trajectory

if TYPE_CHECKING:
    from pandas import DataFrame

    from gridslam.viz.notebook import Picture

__all__ = ["LANDMARK_LOCALIZATION_SCHEMA", "LandmarkLocalizationResult"]

LANDMARK_LOCALIZATION_SCHEMA = "gridslam.landmark_localization/2"


@final
@dataclass(frozen=True, slots=True, eq=False)
class LandmarkLocalizationResult:
    """Online trajectory of the robot in a known landmark map.

    Attributes
    ----------
    stamps_ns : (T,) int64, ns
        Of the steps.
    reports : sequence of EkfLocalizationReport
        One for each.
    landmarks : KnownLandmarks
        The map.
    landmarks_path : Path or None
        Where it was read, unless it is the truth or was given as such.
    in_true_frame : bool
        Whether the map is that of the true landmarks: then errors are computed without alignment.
    unknown : bool
        Whether the correspondences were to be found.
    log : LandmarkLog
    models : dict
        Measurement and motion model, and association.
    digest : str
        SHA-256 of the log's file.
    stopwatch : Stopwatch
        Time spent; saving goes on counting.
    """

    stamps_ns: IntArray
    reports: Sequence[EkfLocalizationReport]
    landmarks: KnownLandmarks
    landmarks_path: Path | None
    in_true_frame: bool
    unknown: bool
    log: LandmarkLog
    models: dict[str, Any]
    digest: str
    stopwatch: Stopwatch

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
        if (compared := self._compared()) is None:
            return None
        return absolute_errors(*compared, aligned=not self.in_true_frame, tolerance_ns=0)

    def save(self, folder: str | Path) -> dict[str, Any]:
        """Write all results into a folder, all or none; returns the content of run.json."""
        with OutputFolder(folder) as out:
            return self.write(out)

    def write(self, out: OutputFolder) -> dict[str, Any]:
        """Write all results into an open output folder; returns the content of run.json."""
        self.stopwatch.resume()
        write_tum(out.file("trajectory.tum"), self.trajectory)
        write_trajectory_csv(out.file("trajectory.csv"), self.trajectory, self.covariances)
        self.stopwatch.lap("write")
        self.picture().save(out.file("landmarks.png"), optimize=False)
        self.stopwatch.lap("draw")
        document = self._document()
        out.write_json("run.json", document)
        return document

    def caption(self) -> list[str]:
        """Lines that describe the result."""
        counts, errors = self.log.statistics, self.errors()
        lines = [
            f"EKF localization, {'unknown' if self.unknown else 'known'} correspondences",
            f"{len(self.stamps_ns)} steps, {counts.observations} observations, "
            f"{len(self.landmarks.names)} known landmarks",
        ]
        if errors is not None:
            lines.append(f"RMSE: position {errors.trans_rmse_m:.3f} m, heading {errors.rot_rmse_deg:.1f} degrees")
        return [*lines, f"{self.stopwatch.stages['solve'][0]:.1f} s: gridslam {__version__}"]

    def _document(self) -> dict[str, Any]:
        """Build the content of run.json."""
        counts, errors = self.log.statistics, self.errors()
        statistics = {**asdict(counts), "duration_s": counts.duration_s, "stamped": self.log.stamped}
        return {
            "schema": LANDMARK_LOCALIZATION_SCHEMA,
            "version": __version__,
            "method": "ekf-localization",
            "correspondences": "unknown" if self.unknown else "known",
            "input": {"path": os.fspath(self.log.path), "sha256": self.digest, **statistics},
            "map": {
                "path": None if self.landmarks_path is None else os.fspath(self.landmarks_path),
                "landmarks": len(self.landmarks.names),
            },
            "outliers": self.outliers,
            "log_likelihood": float(sum(report.log_likelihood for report in self.reports)),
            "errors": None if errors is None else {"aligned": not self.in_true_frame, **asdict(errors)},
            "models": {name: {"kind": type(model).__name__, **asdict(model)} for name, model in self.models.items()},
            "time": self.stopwatch.to_dict(),
        }

    def to_dataframe(self) -> DataFrame:
        """Return a pandas.DataFrame with a row for each step: stamp_ns and the columns of trajectory.csv.

        Raises
        ------
        MissingDependencyError
            pandas is not installed; the extra ``pandas`` brings it.
        """
        return tabulate(self.trajectory, self.covariances)

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

    def picture(self) -> Picture:
        """Draw the trajectory and the landmarks, and the truth where it is known."""
        from gridslam.viz.landmark_picture import draw_landmarks  # only drawing pays for the import of Pillow

        compared = self._compared()
        truth = None if compared is None else compared[1]
        if compared is not None and truth is not None and not self.in_true_frame:
            map_from_true = inverse(align(compared[0].poses[:, :2], truth.poses[:, :2]))
            truth = Trajectory(truth.stamps_ns, compose(map_from_true, truth.poses))
        exact = np.zeros((len(self.landmarks.names), 2, 2))
        return draw_landmarks(
            self.trajectory, self.landmarks.positions, exact, title=self.log.path.name, caption=self.caption(),
            truth=truth, true_positions=self.landmarks.positions, stamped=self.log.stamped,
        )  # fmt: skip
