"""From a log and a trajectory to a map: mapping with known poses, its result and its output files."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal, TypeAlias, final

import numpy as np

from gridslam import __version__
from gridslam.api.result import ScanResult, find_repair
from gridslam.arguments import require_instance, require_threads
from gridslam.checked import checked
from gridslam.config import Configuration, apply_laser, override
from gridslam.doctor.repair import open_repaired
from gridslam.errors import ArgumentError, InputError
from gridslam.io.log import Log, LogOptions, LogSource
from gridslam.io.maps import write_map
from gridslam.io.output import OutputFolder
from gridslam.io.text import compute_digest
from gridslam.io.trajectories import read_trajectory
from gridslam.kernels import FARTHEST
from gridslam.mapping.beam_counts import BeamCounts, bayes_map, counting_map
from gridslam.mapping.known_poses import KnownPoses, NoPoseReason
from gridslam.parameters import to_table
from gridslam.pipeline import Stopwatch
from gridslam.types import FloatArray, OccupancyGrid, Trajectory
from gridslam.viz import draw_map
from gridslam.viz.notebook import Picture

_MOST_CELLS = 3e8
"""1.5 gigabytes, as the map is unfolded; 870 m x 870 m in cells of 5 cm."""

GridModel: TypeAlias = Literal["bayes", "counting"]


@final
@dataclass(frozen=True, slots=True, eq=False, repr=False, kw_only=True)
class GridResult(ScanResult):
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
    max_gap_s : float
    deskew : bool
    configuration : Configuration
        Of which the mapper and the limits of the ranges were used.
    given : Trajectory
        The trajectory as it was given, and the file it came from, if any, in `given_path`.
    """

    schema: ClassVar = "gridslam.grid/1"
    picture_name: ClassVar = "map.png"
    file_names: ClassVar = ("map.yaml", "map.pgm")

    map: OccupancyGrid
    trajectory: Trajectory
    unplaced: Counter[NoPoseReason]
    model: str
    max_gap_s: float
    deskew: bool
    configuration: Configuration
    given: Trajectory
    given_path: Path | None

    @property
    def covariances(self) -> None:
        """None: the poses are taken as exact."""

    def caption(self) -> list[str]:
        """Return lines that describe the map."""
        height, width = (side * self.map.resolution_m for side in self.map.known.shape)
        name = {"bayes": "binary Bayes filter", "counting": "counting model"}[self.model]
        return [
            f"{len(self.trajectory)} scans with known poses: {name}",
            f"{width:.0f} m x {height:.0f} m in cells of {100 * self.map.resolution_m:g} cm",
            f"{self.stopwatch.total()[0]:.1f} s: gridslam {__version__}",
        ]

    def picture(self) -> Picture:
        """Draw the map with the trajectory."""
        return draw_map(self.map, self.trajectory, title=self.source.name, caption=self.caption())

    def _write_files(self, out: OutputFolder) -> None:
        write_map(out.file("map.yaml"), self.map)

    def _describe(self) -> dict[str, Any]:
        log = self.log
        grid = self.map
        config = self.configuration
        height, width = (side * grid.resolution_m for side in grid.known.shape)
        return {
            "model": self.model,
            "deskew": self.deskew,
            "input": self.describe_input()
            | {"truncated": log.truncated, "sensors": list(log.mountings), "remarks": dict(log.remarks)},
            "trajectory": {
                "path": None if self.given_path is None else os.fspath(self.given_path),
                "sha256": None if self.given_path is None else compute_digest(self.given_path),
                "poses": len(self.given),
                "first_stamp_ns": int(self.given.stamps_ns.min()),
                "last_stamp_ns": int(self.given.stamps_ns.max()),
                "max_gap_s": self.max_gap_s,
            },
            "scans": {
                "read": log.scan_count,
                "used": len(self.trajectory),
                "skipped": {reason.value: self.unplaced[reason] for reason in NoPoseReason},
            },
            "map": {"width_m": width, "height_m": height, "known_cells": int(grid.known.sum())},
            "configuration": {
                "range_min_m": config.range_min_m,
                "range_max_m": config.range_max_m,
                "resolution_m": config.mapper.resolution_m,
                "inverse_sensor": to_table(config.mapper.inverse_sensor),
            },
        }


@checked
def map_with_poses(
    log: LogSource,
    trajectory: str | Path | Trajectory,
    *,
    model: GridModel = "bayes",
    max_gap_s: float = 1.0,
    deskew: bool = True,
    resolution_m: float | None = None,
    laser: str | None = None,
    configuration: Configuration | None = None,
    threads: int = 1,
    options: LogOptions | None = None,
    repair: Literal["needed", "none"] = "needed",
    on_progress: Callable[[], None] = lambda: None,
    stopwatch: Stopwatch | None = None,
) -> GridResult:
    """Build the map of a log whose trajectory is known: no SLAM, no matching; the poses are not corrected.

    A scan gets the pose at its own stamp, interpolated between the trajectory's neighbours in time and never
    extrapolated; scans without one are left out and counted. Where beams have times, the trajectory's motion during the
    scan is undone. The odometry of the log is not used.

    Parameters
    ----------
    log : str, Path or Log
        The log, of any format that `open_log` knows.
    trajectory : str, Path or Trajectory
        Poses of the robot's base in the map frame; a path names a file in TUM format.
    model : "bayes" or "counting"
        Inverse sensor model with log-odds, or reflection probability per cell (see `bayes_map` and `counting_map`).
    max_gap_s : float, s, > 0
        Between poses of the trajectory farther apart in time nothing is interpolated.
    deskew : bool
        Undo the motion during a scan, where its beams have times; False for logs whose times mean nothing, of which
        `map_log` finds out by matching.
    resolution_m : float, m, [0.01, 1], optional
        Side of a cell; 5 cm, or what suits the laser, if not given.
    laser : str, optional
        What the laser is, a name of `gridslam.config.LASERS`: limits and cells that suit it.
    configuration : Configuration, optional
        Of which the mapper and the limits of the ranges are used.
    threads : int, >= 1
        Threads of the kernels; their number never changes a result.
    options : LogOptions, optional
        What to read of the log at a path.
    repair : "needed" or "none"
        As for `map_log`; only what is wrong with the laser's mounting matters here.
    on_progress : callable
        Called after each scan.
    stopwatch : Stopwatch, optional
        A stopwatch to continue.

    Raises
    ------
    ArgumentError
        There is no such model, or an argument is out of range.
    InputError
        The log or the trajectory cannot be read, or no scan was taken during the trajectory.
    ConfigurationError
        There is no such laser.
    """
    if model not in ("bayes", "counting"):
        raise ArgumentError("model", "bayes or counting", model)
    require_instance("trajectory", trajectory, str, Path, Trajectory)
    require_instance("configuration", configuration, Configuration, optional=True)
    require_threads(threads)
    config = _choose_configuration(configuration, laser, resolution_m)
    watch = stopwatch or Stopwatch()
    source = open_repaired(log, options, repair)
    path = None if isinstance(trajectory, Trajectory) else Path(trajectory)
    given = trajectory if isinstance(trajectory, Trajectory) else read_trajectory(trajectory)
    _check_size(given, path, config)
    poses = KnownPoses(given, max_gap_s)
    counts = BeamCounts(config.mapper.resolution_m, threads)
    watch.lap("start")
    used, unplaced = _count(source, poses, counts, config, deskew, on_progress)
    watch.lap("count")
    if not len(used):
        raise InputError(path or source.path, _explain_no_map(source, poses, unplaced))
    result = GridResult(
        map=bayes_map(counts, config.mapper.inverse_sensor) if model == "bayes" else counting_map(counts),
        trajectory=used,
        unplaced=unplaced,
        model=model,
        max_gap_s=max_gap_s,
        deskew=deskew,
        configuration=config,
        log=source.statistics,
        repair=find_repair(source),
        given=given,
        source=source.path,
        digest=compute_digest(source.path),
        given_path=path,
        stopwatch=watch,
    )
    watch.lap("map")
    return result


def _check_size(given: Trajectory, path: Path | None, config: Configuration) -> None:
    """Reject a trajectory whose map would be too large: a pose is wrong, or the cells are too small."""
    cell_m = config.mapper.resolution_m
    sides_m = (np.ptp(given.poses[:, :2], axis=0) if len(given) else np.zeros(2)) + 2 * config.range_max_m
    farthest_m = float(np.abs(given.poses[:, :2]).max(initial=0.0))
    limit_m = FARTHEST * cell_m - 2 * config.range_max_m
    problem: tuple[str, str] | None = None
    if not np.prod(sides_m / cell_m) <= _MOST_CELLS:
        got = f"{sides_m[0]:.0f} m x {sides_m[1]:.0f} m in cells of {cell_m:g} m"
        problem = f"poses whose map has at most {_MOST_CELLS:.0e} cells", got
    elif not farthest_m <= limit_m:
        problem = f"poses within {limit_m:.3g} m of the origin, for cells of {cell_m:g} m", f"{farthest_m:g} m"
    if problem is not None:
        expected, got = problem
        if path is None:
            raise ArgumentError("trajectory", expected, got)
        raise InputError(path, f"expected {expected}, got {got}")


def _count(
    source: Log,
    poses: KnownPoses,
    counts: BeamCounts,
    config: Configuration,
    deskew: bool,
    on_progress: Callable[[], None],
) -> tuple[Trajectory, Counter[NoPoseReason]]:
    """Count all scans; give where those were taken that have a pose, and why the others have none."""
    stamps = list[int]()
    taken = list[FloatArray]()
    unplaced = Counter[NoPoseReason]()
    for _, scan in source:
        pose = poses.at(scan.stamp_ns)
        if isinstance(pose, NoPoseReason):
            unplaced[pose] += 1
        else:
            beams = scan.beams(config.range_min_m, config.range_max_m, config.thinning)
            counts.add(pose, poses.deskew(beams) if deskew else beams)
            stamps.append(scan.stamp_ns)
            taken.append(pose)
        on_progress()
    return Trajectory(np.array(stamps, np.int64), np.array(taken).reshape(-1, 3)), unplaced


def _choose_configuration(base: Configuration | None, laser: str | None, resolution_m: float | None) -> Configuration:
    config = base or Configuration()
    config = config if laser is None else apply_laser(config, laser)
    if resolution_m is None:
        return config
    if not 0 < resolution_m <= 1:
        raise ArgumentError("resolution_m", "above 0, at most 1 m", resolution_m)
    return override(config, f"resolution_m={resolution_m}")


def _explain_no_map(source: Log, poses: KnownPoses, unplaced: Counter[NoPoseReason]) -> str:
    """Return why there is no map."""
    log = source.statistics
    if log.first_stamp_ns is None or log.last_stamp_ns is None or not sum(unplaced.values()):
        return "expected a log with scans, got one without"
    if unplaced[NoPoseReason.GAP]:
        return f"expected poses about the scans' stamps, got none near enough to any of {unplaced.total()} scans"
    first, last = poses.span_ns
    return (
        f"expected a trajectory of this log, but it lasts from {first * 1e-9:.3f} to {last * 1e-9:.3f} s and the log's "
        f"scans from {log.first_stamp_ns * 1e-9:.3f} to {log.last_stamp_ns * 1e-9:.3f} s"
    )
