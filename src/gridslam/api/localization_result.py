"""What localizing a log in a map gives, and the files it is kept in."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from gridslam import __version__
from gridslam.api.showing import describe_result, tabulate
from gridslam.config.tables import to_table
from gridslam.doctor.repair import Repair
from gridslam.io.log_statistics import LogStatistics
from gridslam.io.output import OutputFolder
from gridslam.io.trajectories import write_trajectory_csv, write_tum
from gridslam.localization.monte_carlo import MonteCarloConfiguration
from gridslam.localization.state import LocalizationReport, LocalizationSkip, MonteCarloState
from gridslam.pipeline import Stopwatch
from gridslam.types import FloatArray, IntArray, OccupancyGrid, Trajectory

if TYPE_CHECKING:
    from pandas import DataFrame

    from gridslam.viz.notebook import Picture

__all__ = ["BELIEF_HEADER", "LOCALIZATION_SCHEMA", "LocalizationInterval", "LocalizationResult"]

LOCALIZATION_SCHEMA = "gridslam.localization/2"
BELIEF_HEADER = "stamp_s,lost,lost_probability,inlier_ratio,particles,n_eff,injection_ratio"
"""First line of belief.csv: a row for each scan; n_eff is empty where the particles were not updated."""


class LocalizationInterval(NamedTuple):
    """Scans in a row at which the robot was found, or lost.

    Attributes
    ----------
    lost : bool
    first, last : int
        Which scans, counted from 0.
    driven_m : float
        Way before the first of them, by odometry.
    """

    lost: bool
    first: int
    last: int
    driven_m: float


@final
@dataclass(frozen=True, slots=True, eq=False)
class LocalizationResult:
    """A robot's way in a known map, and how it was found.

    Attributes
    ----------
    reports : list of LocalizationReport
        One for each scan, without particles.
    driven_m : (N,) float64
        Way up to each scan, by odometry.
    map : OccupancyGrid
    state : MonteCarloState
        The filter after the last scan.
    configuration : MonteCarloConfiguration
        The effective parameters.
    pose : (3,) float64 or None
        Initial pose; None for global localization.
    seed, threads : int
        As given.
    log : LogStatistics
        What was met in the log.
    source, map_path : Path
        The log, and the map's YAML file or, for a map that was given as such, an empty path.
    digest : str
        SHA-256 of the log.
    remarks : tuple of str
        What is odd about the map's file.
    repair : Repair
        What was taken out of the log.
    stopwatch : Stopwatch
        Time spent; saving goes on counting.
    """

    reports: list[LocalizationReport]
    driven_m: FloatArray
    map: OccupancyGrid
    state: MonteCarloState
    configuration: MonteCarloConfiguration
    pose: FloatArray | None
    seed: int
    threads: int
    log: LogStatistics
    source: Path
    map_path: Path
    digest: str
    remarks: tuple[str, ...]
    repair: Repair
    stopwatch: Stopwatch

    @property
    def trajectory(self) -> Trajectory:
        """Online pose of each scan, map frame; a guess where the robot was lost."""
        return Trajectory(self.stamps_ns, np.array([report.pose for report in self.reports]))

    @property
    def stamps_ns(self) -> IntArray:
        """Stamps (N,) of the scans."""
        return np.array([report.stamp_ns for report in self.reports], np.int64)

    @property
    def covariances(self) -> FloatArray:
        """Covariances (N, 3, 3) of the poses."""
        return np.array([report.covariance for report in self.reports])

    @property
    def lost(self) -> NDArray[np.bool_]:
        """Whether the robot was lost at each scan: (N,)."""
        return np.array([report.lost for report in self.reports])

    def intervals(self) -> list[LocalizationInterval]:
        """Where the robot was found and where it was lost, in order."""
        lost = self.lost
        begins = np.flatnonzero(np.diff(lost, prepend=~lost[:1]))
        ends = np.append(begins[1:], len(lost)) - 1
        pairs = zip(begins.tolist(), ends.tolist(), strict=True)
        return [LocalizationInterval(bool(lost[a]), a, b, float(self.driven_m[a])) for a, b in pairs]

    def save(self, folder: str | Path) -> dict[str, Any]:
        """Write all results into a folder, all or none; returns the content of run.json."""
        with OutputFolder(folder) as out:
            return self.write(out)

    def write(self, out: OutputFolder) -> dict[str, Any]:
        """Write all results into an open output folder; returns the content of run.json."""
        self.stopwatch.resume()
        write_tum(out.file("trajectory.tum"), self.trajectory)
        write_trajectory_csv(out.file("trajectory.csv"), self.trajectory, self.covariances)
        out.file("belief.csv").write_text("\n".join([BELIEF_HEADER, *self._belief(), ""]), encoding="ascii")
        self.stopwatch.lap("write")
        self.picture().save(out.file("localization.png"), optimize=False)
        self.stopwatch.lap("draw")
        document = self.document()
        out.write_json("run.json", document)
        return document

    def document(self) -> dict[str, Any]:
        """Build the content of run.json."""
        return {
            "schema": LOCALIZATION_SCHEMA,
            "version": __version__,
            "seed": self.seed,
            "threads": self.threads,
            "input": self._input(),
            "initial_pose": "global" if self.pose is None else self.pose.tolist(),
            "scans": self._scans(),
            "filter": self._filter(),
            "intervals": [self._interval_document(interval) for interval in self.intervals()],
            "time": self.stopwatch.to_dict(),
            "configuration": to_table(self.configuration),
        }

    def caption(self) -> list[str]:
        """Lines that describe the result."""
        scans, lost = len(self.reports), int(self.lost.sum())
        found = next((interval for interval in self.intervals() if not interval.lost), None)
        where = "never found" if found is None else f"found after {found.driven_m:.1f} m"
        start = where if self.pose is None else f"begun at {', '.join(f'{v:g}' for v in self.pose)}"
        return [
            f"{scans} scans, {self.log.duration_s:.0f} s, {self.driven_m[-1]:.0f} m driven",
            f"{start}; lost at {lost} of {scans} scans",
            f"seed {self.seed}, {self.stopwatch.total()[0]:.1f} s: gridslam {__version__}",
        ]

    def to_dataframe(self) -> DataFrame:
        """Return a pandas.DataFrame with a row for each scan: stamp_ns, the columns of trajectory.csv, and
        lost, lost_probability, inlier_ratio and particles.

        Raises
        ------
        MissingDependencyError
            pandas is not installed; the extra ``pandas`` brings it.
        """
        told = ("lost_probability", "inlier_ratio", "particles")
        more = {name: [getattr(report, name) for report in self.reports] for name in told}
        return tabulate(self.trajectory, self.covariances, lost=self.lost, **more)

    def __repr__(self) -> str:
        """Return one line."""
        return describe_result(self, self.source.name, self.caption()[:2])

    def _repr_png_(self) -> bytes:
        from gridslam.viz.notebook import encode_png

        return encode_png(self.picture())

    def _input(self) -> dict[str, Any]:
        return {
            "path": os.fspath(self.source),
            "sha256": self.digest,
            "map": os.fspath(self.map_path),
            "map_remarks": list(self.remarks),
            "selection": self.log.selection,
            "duration_s": self.log.duration_s,
            "odometry_length_m": float(self.driven_m[-1]),
            "repair": asdict(self.repair) if self.repair else None,
        }

    def _scans(self) -> dict[str, Any]:
        reasons = [report.skipped for report in self.reports]
        skipped = {reason.value: reasons.count(reason) for reason in LocalizationSkip if reason in reasons}
        return {"read": len(reasons), "used": reasons.count(None), "skipped": skipped, "lost": int(self.lost.sum())}

    def _filter(self) -> dict[str, Any]:
        updates = [report for report in self.reports if report.skipped is None]
        return {
            "particles_mean": float(np.mean([report.particles for report in updates])),
            "particles_max": max(report.particles for report in updates),
            "n_eff_mean": float(np.mean([report.n_eff for report in updates])),
            "inlier_ratio_mean": float(np.mean([report.inlier_ratio for report in updates])),
            "injected_updates": sum(report.injection_ratio > 0 for report in updates),
        }

    def _interval_document(self, interval: LocalizationInterval) -> dict[str, Any]:
        stamps = self.stamps_ns[[interval.first, interval.last]].tolist()
        return {"lost": interval.lost, "stamps_ns": stamps, "driven_m": interval.driven_m}

    def _belief(self) -> Iterator[str]:
        for r in self.reports:
            n_eff = f"{r.n_eff:.1f}" if r.skipped is None else ""
            whole, rest = divmod(r.stamp_ns, 10**9)
            yield (
                f"{whole}.{rest:09d},{r.lost:d},{r.lost_probability:.6g},{r.inlier_ratio:.4f},{r.particles},{n_eff},"
                f"{r.injection_ratio:.4g}"
            )

    def picture(self) -> Picture:
        """Draw the map with the trajectory, and where the robot was lost."""
        from gridslam.viz.localization_picture import draw_localization  # only drawing pays for the import of Pillow

        return draw_localization(
            self.map, self.trajectory, self.lost, title=self.source.name, caption=self.caption()
        )  # fmt: skip
