"""Result of a mapping run, and its output files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

import numpy as np

from gridslam import __version__
from gridslam.api.document import run_document
from gridslam.api.showing import describe_result, tabulate
from gridslam.config import Configuration
from gridslam.doctor.repair import Repair
from gridslam.grid.tiles import TiledGrid
from gridslam.io.g2o import write_g2o
from gridslam.io.log_statistics import LogStatistics
from gridslam.io.maps import write_map
from gridslam.io.output import OutputFolder
from gridslam.io.results.record import RecordWriter
from gridslam.io.trajectories import write_trajectory_csv, write_tum
from gridslam.observers import RunStatistics
from gridslam.pipeline import Stopwatch
from gridslam.slam.full_slam.full_slam import LoopClosureSummary
from gridslam.slam.grid_fastslam.state import GridFastSlamState
from gridslam.slam.pose_graph.pose_graph import PoseGraph
from gridslam.types import FloatArray, IntArray, OccupancyGrid, Trajectory

if TYPE_CHECKING:
    from pandas import DataFrame

    from gridslam.viz.notebook import Picture

__all__ = ["MapResult"]

_MOST_DRAWN, _APART = 300, 20
"""Recognized closures in the picture, of more every second, third, ... is drawn; key scans between two known ones."""


@final
@dataclass(frozen=True, slots=True, eq=False)
class MapResult:
    """Map and trajectory of a log, and how they came about.

    Attributes
    ----------
    trajectory : Trajectory
        The full SLAM trajectory: the pose of every scan given all measurements, at the scan's own stamp.
    covariances : (N, 3, 3) float64
        Of its poses, by x, y in m and theta in rad, map frame, given that the first pose is exact.
    online_trajectory : Trajectory
        The online trajectory: the pose of the best particle at each scan.
    tiled_map : TiledGrid
        The map, drawn from the trajectory.
    graph : PoseGraph
        The key scans and what was measured between them.
    loop_summary : LoopClosureSummary or None
        Summary of loop closure; None without loop closure.
    key_stamps_ns : (T,) int64, ns
        Stamps of the key scans, the nodes of the graph.
    state : GridFastSlamState
        The filter after the last scan; of its particles maybe only the best (see `map_log`).
    maps_bytes : int
        Bytes of all particles' maps then.
    statistics : RunStatistics
        Counts and latencies.
    log : LogStatistics
        What was met in the log.
    configuration : Configuration
        The effective one.
    seed, threads : int
        As given.
    source : Path
        The log.
    digest : str
        Its SHA-256.
    repair : Repair
        What was taken out of it.
    record : RecordWriter
        The particles at each key scan.
    stopwatch : Stopwatch
        Time spent; saving goes on counting.
    """

    trajectory: Trajectory
    covariances: FloatArray
    online_trajectory: Trajectory
    tiled_map: TiledGrid
    graph: PoseGraph
    loop_summary: LoopClosureSummary | None
    key_stamps_ns: IntArray
    state: GridFastSlamState
    maps_bytes: int
    statistics: RunStatistics
    log: LogStatistics
    configuration: Configuration
    seed: int
    threads: int
    source: Path
    digest: str
    repair: Repair
    record: RecordWriter
    stopwatch: Stopwatch

    def save(self, folder: str | Path) -> dict[str, Any]:
        """Write all results into a folder, all or none; returns the content of run.json.

        Raises
        ------
        OutputError
            The folder cannot be written.
        """
        with OutputFolder(folder) as out:
            return self.write(out)

    def write(self, out: OutputFolder, *, truth: Trajectory | None = None) -> dict[str, Any]:
        """Write all results into an open output folder; returns the content of run.json.

        A true trajectory in the map's frame is drawn into the picture, too.
        """
        self.stopwatch.resume()
        write_map(out.file("map.yaml"), self.tiled_map)
        write_tum(out.file("trajectory.tum"), self.trajectory)
        write_trajectory_csv(out.file("trajectory.csv"), self.trajectory, self.covariances)
        write_tum(out.file("trajectory_online.tum"), self.online_trajectory)
        write_g2o(out.file("graph.g2o"), self.graph)
        self.record.write(out.file("record.npz"))
        self.stopwatch.lap("write")
        self.picture(truth).save(out.file("map.png"), optimize=False)
        self.stopwatch.lap("draw")
        document = run_document(self)
        out.write_json("run.json", document)
        return document

    @property
    def map(self) -> OccupancyGrid:
        """The map as one array, built at each access."""
        return self.tiled_map.whole()

    @property
    def driven(self) -> str:
        """Odometry path length as text."""
        log = self.log
        return "no odometry" if log.without_odometry == log.scan_count else f"{log.odometry_length_m:.0f} m driven"

    def caption(self) -> list[str]:
        """Lines that describe the map."""
        height, width = (side * self.tiled_map.resolution_m for side in self.tiled_map.shape)
        log, wall = self.log, self.stopwatch.total()[0]
        places, loops = "", self.loop_summary
        if loops is not None:
            places = f", {len(loops.closures)} places recognized, {len(loops.tracked_revisits)} known again"
        return [
            f"{len(self.trajectory)} scans, {log.duration_s:.0f} s, {self.driven}{places}",
            f"{width:.0f} m x {height:.0f} m in cells of {100 * self.tiled_map.resolution_m:g} cm",
            f"{self.configuration.particles} particles, seed {self.seed}, {wall:.1f} s: gridslam {__version__}",
        ]

    def picture(self, truth: Trajectory | None = None) -> Picture:
        """Draw the map with the trajectory and its closures; a true trajectory in the map's frame is drawn, too."""
        from gridslam.viz import draw_map  # only drawing pays for the import of Pillow

        return draw_map(
            self.tiled_map, self.trajectory, title=self.source.name, caption=self.caption(), truth=truth,
            closures=None if self.loop_summary is None else self._drawn(self.loop_summary),
        )  # fmt: skip

    def to_dataframe(self) -> DataFrame:
        """Return a pandas.DataFrame with a row for each scan: stamp_ns and the columns of trajectory.csv.

        Raises
        ------
        MissingDependencyError
            pandas is not installed; the extra ``pandas`` brings it.
        """
        return tabulate(self.trajectory, self.covariances)

    def __repr__(self) -> str:
        """Return one line."""
        return describe_result(self, self.source.name, self.caption())

    def _repr_png_(self) -> bytes:
        from gridslam.viz.notebook import encode_png

        return encode_png(self.picture())

    def _drawn(self, loops: LoopClosureSummary) -> FloatArray:
        """Lines (K, 4) of closures: the recognized ones, and some of those whose place was known."""
        recognized = loops.closures[:: -(-len(loops.closures) // _MOST_DRAWN) or 1]
        known = loops.tracked_revisits[np.flatnonzero(np.diff(loops.tracked_revisits[:, 1] // _APART, prepend=-1))]
        ends: FloatArray = self.graph.poses[np.concatenate([known, recognized]), :2].reshape(-1, 4)
        return ends
