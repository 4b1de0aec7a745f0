"""From a log and a trajectory to a map: mapping with known poses."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np

from gridslam.api.grid_result import GridResult
from gridslam.arguments import require_instance, require_threads
from gridslam.config import Configuration, apply_laser, override
from gridslam.doctor.repair import Repair, RepairedLog, open_repaired
from gridslam.errors import ArgumentError, InputError
from gridslam.io.log import Log, LogOptions, LogSource
from gridslam.io.text import compute_digest
from gridslam.io.trajectories import read_tum
from gridslam.mapping.beam_counts import BeamCounts, bayes_map, counting_map
from gridslam.mapping.known_poses import KnownPoses, NoPoseReason
from gridslam.pipeline import Stopwatch
from gridslam.types import FloatArray, LaserScan, Trajectory

__all__ = ["GridModel", "map_with_poses"]

_MOST_CELLS = 2e9
"""Ten gigabytes; 2 km x 2 km in cells of 5 cm."""

GridModel: TypeAlias = Literal["bayes", "counting"]


def map_with_poses(
    log: LogSource,
    trajectory: str | Path | Trajectory,
    *,
    model: GridModel = "bayes",
    half_life_scans: float | None = None,
    resolution_m: float | None = None,
    laser: str | None = None,
    configuration: Configuration | None = None,
    max_gap_s: float = 1.0,
    deskew: bool = True,
    options: LogOptions | None = None,
    repair: Literal["needed", "all", "none"] = "needed",
    threads: int = 1,
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
    half_life_scans : float, optional
        Number of scans observing a cell after which the weight of a scan is halved, so that moving objects fade; no
        decay if not given (see `BeamCounts`).
    resolution_m : float, m, (0, 1], optional
        Side of a cell; 5 cm, or what suits the laser, if not given.
    laser : str, optional
        What the laser is, a name of `gridslam.config.LASERS`: limits and cells that suit it.
    configuration : Configuration, optional
        Of which the mapper and the limits of the ranges are used.
    max_gap_s : float, s, > 0
        Between poses of the trajectory farther apart in time nothing is interpolated.
    deskew : bool
        Undo the motion during a scan, where its beams have times; False for logs whose times mean nothing, of which
        `map_log` finds out by matching.
    options : LogOptions, optional
        What to read of the log at a path.
    repair : "needed", "all" or "none"
        As for `map_log`; only what is wrong with the laser's mounting matters here.
    threads : int, >= 1
        Threads of the kernels; their number never changes a result.
    on_progress : callable
        Called after each scan.
    stopwatch : Stopwatch, optional
        To go on with.

    Raises
    ------
    ArgumentError
        There is no such model, or an argument is out of range.
    InputError
        The log or the trajectory cannot be read, or no scan was taken during the trajectory.
    ConfigurationError
        There is no such laser.
    """
    _check(model, trajectory, configuration, threads)
    config = _configuration(configuration, laser, resolution_m)
    watch = stopwatch or Stopwatch()
    source = open_repaired(log, options, repair)
    path = None if isinstance(trajectory, Trajectory) else Path(trajectory)
    given = _given(trajectory, config)
    poses = KnownPoses(given, max_gap_s)
    counts = BeamCounts(config.mapper.resolution_m, half_life_scans, threads)
    watch.lap("start")
    used, unplaced = _count(source, poses, counts, config, deskew, on_progress)
    watch.lap("count")
    if not len(used):
        raise InputError(path or source.path, _nothing(source, poses, unplaced))
    result = GridResult(
        map=bayes_map(counts, config.mapper.inverse_sensor) if model == "bayes" else counting_map(counts),
        trajectory=used, unplaced=unplaced, model=model, half_life_scans=half_life_scans, max_gap_s=max_gap_s,
        deskew=deskew, configuration=config, log=source.statistics, repair=_repair_of(source), given=given,
        source=source.path, digest=compute_digest(source.path), given_path=path, stopwatch=watch,
    )  # fmt: skip
    watch.lap("map")
    return result


def _check(model: str, trajectory: object, configuration: object, threads: int) -> None:
    if model not in ("bayes", "counting"):
        raise ArgumentError("model", "bayes or counting", model)
    require_instance("trajectory", trajectory, str, Path, Trajectory)
    require_instance("configuration", configuration, Configuration, optional=True)
    require_threads(threads)


def _given(trajectory: str | Path | Trajectory, config: Configuration) -> Trajectory:
    """Read a trajectory; refuse one whose map no memory holds: a pose in it is wrong, or cells are too small."""
    given = trajectory if isinstance(trajectory, Trajectory) else read_tum(trajectory)
    sides_m = (np.ptp(given.poses[:, :2], axis=0) if len(given) else np.zeros(2)) + 2 * config.range_max_m
    if np.prod(sides_m / config.mapper.resolution_m) > _MOST_CELLS:
        expected, cell_m = f"poses whose map has at most {_MOST_CELLS:.0e} cells", config.mapper.resolution_m
        got = f"{sides_m[0]:.0f} m x {sides_m[1]:.0f} m in cells of {cell_m:g} m"
        if isinstance(trajectory, Trajectory):
            raise ArgumentError("trajectory", expected, got)
        raise InputError(trajectory, f"expected {expected}, got {got}")
    return given


def _count(
    source: Log, poses: KnownPoses, counts: BeamCounts, config: Configuration, deskew: bool,
    on_progress: Callable[[], None],
) -> tuple[Trajectory, Counter[NoPoseReason]]:  # fmt: skip
    """Count all scans; give where those were taken that have a pose, and why the others have none."""
    stamps, taken, unplaced = list[int](), list[FloatArray](), Counter[NoPoseReason]()
    scan: LaserScan
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


def _repair_of(log: Log) -> Repair:
    return (log.repair if isinstance(log, RepairedLog) else None) or Repair()


def _configuration(base: Configuration | None, laser: str | None, resolution_m: float | None) -> Configuration:
    config = base or Configuration()
    config = config if laser is None else apply_laser(config, laser)
    if resolution_m is None:
        return config
    if not 0 < resolution_m <= 1:
        raise ArgumentError("resolution_m", "above 0, at most 1 m", resolution_m)
    return override(config, f"resolution_m={resolution_m}")


def _nothing(source: Log, poses: KnownPoses, unplaced: Counter[NoPoseReason]) -> str:
    """Why there is no map."""
    log, (first, last) = source.statistics, poses.span_ns
    if log.first_stamp_ns is None or log.last_stamp_ns is None or not sum(unplaced.values()):
        return "expected a log with scans, got one without"
    ours, theirs = ((a * 1e-9, b * 1e-9) for a, b in ((first, last), (log.first_stamp_ns, log.last_stamp_ns)))
    if unplaced[NoPoseReason.GAP]:
        return f"expected poses about the scans' stamps, got none near enough to any of {unplaced.total()} scans"
    return (
        f"expected a trajectory of this log, but it lasts from {ours[0]:.3f} to {ours[1]:.3f} s and the log's scans "
        f"from {theirs[0]:.3f} to {theirs[1]:.3f} s"
    )
