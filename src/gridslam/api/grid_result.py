"""Result of mapping with known poses, and its output files."""

from __future__ import annotations

import os
from collections import Counter
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

from gridslam import __version__
from gridslam.api.showing import describe_result, tabulate
from gridslam.config import Configuration
from gridslam.config.tables import to_table
from gridslam.doctor.repair import Repair
from gridslam.io.log_statistics import LogStatistics
from gridslam.io.maps import write_map
from gridslam.io.output import OutputFolder
from gridslam.io.text import compute_digest
from gridslam.mapping.known_poses import NoPoseReason
from gridslam.pipeline import Stopwatch
from gridslam.types import OccupancyGrid, Trajectory

if TYPE_CHECKING:
    from pandas import DataFrame

    from gridslam.viz.notebook import Picture

__all__ = ["GRID_SCHEMA", "GridResult"]

GRID_SCHEMA = "gridslam.grid/1"


@final
@dataclass(frozen=True, slots=True, eq=False)
class GridResult:
    """The map of a log by a known trajectory, and how it came about.

    Attributes
    ----------
    map : OccupancyGrid
    trajectory : Trajectory
        Where the mapped scans were taken, in the log's order.
    unplaced : Counter of NoPoseReason
        Scans that are not in the map, by reason.
    model : str
        "bayes" or "counting".
    half_life_scans : float or None
    max_gap_s : float
    deskew : bool
    configuration : Configuration
        Of which the mapper and the limits of the ranges were used.
    log : LogStatistics
        What was met in the log.
    source : Path
        The log.
    digest : str
        Its SHA-256.
    given : Trajectory
        The trajectory as it was given, and the file it came from, if any, in `given_path`.
    repair : Repair
        What was taken out of the log.
    stopwatch : Stopwatch
        Time spent; saving goes on counting.
    """

    map: OccupancyGrid
    trajectory: Trajectory
    unplaced: Counter[NoPoseReason]
    model: str
    half_life_scans: float | None
    max_gap_s: float
    deskew: bool
    configuration: Configuration
    log: LogStatistics
    source: Path
    digest: str
    given: Trajectory
    given_path: Path | None
    repair: Repair
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

    def write(self, out: OutputFolder) -> dict[str, Any]:
        """Write all results into an open output folder; returns the content of run.json."""
        self.stopwatch.resume()
        write_map(out.file("map.yaml"), self.map)
        self.stopwatch.lap("write")
        self.picture().save(out.file("map.png"), optimize=False)
        self.stopwatch.lap("draw")
        document = self._document()
        out.write_json("run.json", document)
        return document

    def caption(self) -> list[str]:
        """Lines that describe the map."""
        height, width = (side * self.map.resolution_m for side in self.map.known.shape)
        fading = "" if self.half_life_scans is None else f", half-life {self.half_life_scans:g} scans"
        name = {"bayes": "binary Bayes filter", "counting": "counting model"}[self.model]
        return [
            f"{len(self.trajectory)} scans with known poses: {name}{fading}",
            f"{width:.0f} m x {height:.0f} m in cells of {100 * self.map.resolution_m:g} cm",
            f"{self.stopwatch.total()[0]:.1f} s: gridslam {__version__}",
        ]

    def picture(self) -> Picture:
        """Draw the map with the trajectory."""
        from gridslam.viz import draw_map  # only drawing pays for the import of Pillow

        return draw_map(self.map, self.trajectory, title=self.source.name, caption=self.caption())

    def to_dataframe(self) -> DataFrame:
        """Return a pandas.DataFrame with a row for each mapped scan: stamp_ns, x_m, y_m and theta_rad.

        Raises
        ------
        MissingDependencyError
            pandas is not installed; the extra ``pandas`` brings it.
        """
        return tabulate(self.trajectory)

    def __repr__(self) -> str:
        """Return one line."""
        return describe_result(self, self.source.name, self.caption())

    def _repr_png_(self) -> bytes:
        from gridslam.viz.notebook import encode_png

        return encode_png(self.picture())

    def _document(self) -> dict[str, Any]:
        """Build the content of run.json."""
        grid, config = self.map, self.configuration
        height, width = (side * grid.resolution_m for side in grid.known.shape)
        return {
            "schema": GRID_SCHEMA,
            "version": __version__,
            "model": self.model,
            "half_life_scans": self.half_life_scans,
            "deskew": self.deskew,
            "input": self._input(),
            "trajectory": self._given(),
            "scans": {
                "read": self.log.scan_count,
                "used": len(self.trajectory),
                "skipped": {reason.value: self.unplaced[reason] for reason in NoPoseReason},
            },
            "map": {"width_m": width, "height_m": height, "known_cells": int(grid.known.sum())},
            "time": self.stopwatch.to_dict(),
            "configuration": {
                "range_min_m": config.range_min_m,
                "range_max_m": config.range_max_m,
                "resolution_m": config.mapper.resolution_m,
                "inverse_sensor": to_table(config.mapper.inverse_sensor),
            },
        }

    def _input(self) -> dict[str, Any]:
        log = self.log
        return {
            "path": os.fspath(self.source),
            "sha256": self.digest,
            "truncated": log.truncated,
            "selection": log.selection,
            "duration_s": log.duration_s,
            "sensors": list(log.mountings),
            "remarks": dict(log.remarks),
            "repair": asdict(self.repair) if self.repair else None,
        }

    def _given(self) -> dict[str, Any]:
        return {
            "path": None if self.given_path is None else os.fspath(self.given_path),
            "sha256": None if self.given_path is None else compute_digest(self.given_path),
            "poses": len(self.given),
            "first_stamp_ns": int(self.given.stamps_ns.min()),
            "last_stamp_ns": int(self.given.stamps_ns.max()),
            "max_gap_s": self.max_gap_s,
        }
