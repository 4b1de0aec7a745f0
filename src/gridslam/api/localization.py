"""Localize the robot of a log in a map."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from gridslam.api.localization_result import LocalizationResult
from gridslam.arguments import require_instance, require_seed, require_threads
from gridslam.doctor.repair import Repair, RepairedLog, open_repaired
from gridslam.errors import ArgumentError, InputError
from gridslam.io.log import Log, LogOptions, LogSource
from gridslam.io.maps import read_map
from gridslam.io.measurement import Measurement
from gridslam.io.text import compute_digest
from gridslam.localization.known_map import KnownMap
from gridslam.localization.monte_carlo import MonteCarloConfiguration, MonteCarloLocalization
from gridslam.localization.state import LocalizationObserver, LocalizationReport, MonteCarloState
from gridslam.pipeline import Stopwatch, run
from gridslam.types import FloatArray, OccupancyGrid, Odometry

__all__ = ["INITIAL_COVARIANCE", "known_map", "localize"]

INITIAL_COVARIANCE: FloatArray = np.diag([0.25, 0.25, (math.pi / 12) ** 2])
"""Default covariance of an initial pose: 0.5 m and 15 degrees, as in AMCL."""

_FOUND, _TRIED_M = 0.2, 5.0  # found at a smaller share of the scans on so long a way: the log is of somewhere else


def localize(
    log: LogSource,
    map: str | Path | OccupancyGrid | KnownMap,
    *,
    pose: ArrayLike | None = None,
    covariance: ArrayLike = INITIAL_COVARIANCE,
    seed: int = 0,
    options: LogOptions | None = None,
    configuration: MonteCarloConfiguration | None = None,
    threads: int = 1,
    strict_thresholds: bool = False,
    repair: Literal["needed", "all", "none"] = "needed",
    observers: Sequence[LocalizationObserver] = (),
    gate: Callable[[Iterable[Measurement]], Iterable[Measurement]] = iter,
    stopwatch: Stopwatch | None = None,
) -> LocalizationResult:
    """Localize the robot of a log in a map, by Monte Carlo localization.

    Parameters
    ----------
    log : str, Path or Log
        The log, of any format that `open_log` knows.
    map : str, Path, OccupancyGrid or KnownMap
        The map: the YAML file of map_server or nav2, or a map at hand.
    pose : (3,) float64, optional
        Where the robot is at the first scan, map frame [x m, y m, theta rad]; it is found if not given.
    covariance : (3, 3) float64, m^2, m rad, rad^2
        Of that pose.
    seed : int, >= 0
        The same log, map, parameters and seed give identical results.
    options : LogOptions, optional
        What to read of the log at a path.
    configuration : MonteCarloConfiguration, optional
        Of the filter.
    threads : int, >= 1
        Threads of the kernels; their number never changes a result.
    strict_thresholds : bool
        Read the thresholds of the map's file literally (see `gridslam.io.maps.read_map`).
    repair : "needed", "all" or "none"
        As for `gridslam.map_log`: what is taken out of the log.
    observers : sequence of LocalizationObserver
        Called after each scan.
    gate : callable
        Gets the measurements on their way to the filter and gives them on, as they are, when they may go.
    stopwatch : Stopwatch, optional
        To go on with.

    Returns
    -------
    LocalizationResult
        The online pose estimate of every scan; `lost` marks those that are guesses.

    Raises
    ------
    ArgumentError
        The seed is negative, there is no thread, the pose or its covariance are none, or both `options` and a log that
        is open already are given.
    InputError
        The log or the map cannot be read, the map has no free or no occupied cell, the log has no odometry or no scan
        that can be used, or nothing in it looks like the map.
    """
    require_seed(seed)
    require_threads(threads)
    require_instance("map", map, str, Path, OccupancyGrid, KnownMap)
    require_instance("configuration", configuration, MonteCarloConfiguration, optional=True)
    watch, configuration = stopwatch or Stopwatch(), configuration or MonteCarloConfiguration()
    source = open_repaired(log, options, repair)
    path, known, remarks = known_map(map, configuration, threads, strict_thresholds=strict_thresholds)
    rng, mcl = np.random.default_rng(seed), MonteCarloLocalization(known, configuration)
    state = mcl.init() if pose is None else mcl.init_gaussian(pose, covariance, rng)
    watch.lap("start")
    told = _ReportRecorder()
    state = run(gate(source), mcl, rng=rng, observers=[*observers, told], state=state, stopwatch=watch)
    driven, taken_out = np.array(told.driven_m), source.repair if isinstance(source, RepairedLog) else None
    _check(source, path, told.reports, driven, configuration)
    result = LocalizationResult(
        told.reports, driven, known.grid, state, configuration,
        None if pose is None else np.array(pose, np.float64), seed, threads, source.statistics, source.path, path,
        compute_digest(source.path), remarks, taken_out or Repair(), watch,
    )  # fmt: skip
    watch.lap("finish")
    return result


def known_map(
    source: str | Path | OccupancyGrid | KnownMap, configuration: MonteCarloConfiguration, threads: int = 1, *,
    strict_thresholds: bool = False,
) -> tuple[Path, KnownMap, tuple[str, ...]]:  # fmt: skip
    """Read a map and lay it out; also gives its path, empty for a map at hand, and what is odd about its file.

    Raises InputError where a file is no map in which a robot could be.
    """
    if isinstance(source, KnownMap):
        return Path(), source, ()
    if isinstance(source, OccupancyGrid):
        return Path(), KnownMap(source, reach_m=configuration.reach_m, threads=threads), ()
    remarks = list[str]()
    grid = read_map(source, strict_thresholds=strict_thresholds, tell=remarks.append)
    try:
        return Path(source), KnownMap(grid, reach_m=configuration.reach_m, threads=threads), tuple(remarks)
    except ArgumentError as error:
        raise InputError(source, str(error).removeprefix("map: ")) from None


class _ReportRecorder:
    """Observer that keeps reports (without particles) and the path length (m) at each."""

    def __init__(self) -> None:
        self.reports, self.driven_m = list[LocalizationReport](), list[float]()
        self._last: Odometry | None = None

    def __call__(self, report: LocalizationReport, state: MonteCarloState, seconds: float) -> None:
        """Keep a report."""
        last, self._last = self._last, state.last
        way = 0.0 if last is None or state.last is None else float(np.hypot(*(state.last.pose - last.pose)[:2]))
        self.reports.append(replace(report, poses=None, log_weights=None, parents=None))
        self.driven_m.append(way + (self.driven_m[-1] if self.driven_m else 0.0))


def _check(
    log: Log,
    path: Path,
    reports: list[LocalizationReport],
    driven_m: FloatArray,
    configuration: MonteCarloConfiguration,
) -> None:
    """Raise if the log does not match the map; ambiguity alone is not an error."""
    updates = [report for report in reports if report.skipped is None]
    if not updates:
        lacks = "odometry, which localization needs" if log.statistics.without_odometry else "scan with a usable beam"
        raise InputError(log.path, f"has no {lacks}")
    best, found = max(report.inlier_ratio for report in updates), np.mean([not report.lost for report in reports])
    usual = float(np.median([report.inlier_ratio for report in updates]))
    sought = np.mean([report.injection_ratio > 0 for report in updates])  # all over the map, again and again
    fits = usual >= configuration.recovery.expected and sought < 0.5
    if best < configuration.lost_below or (found < _FOUND and driven_m[-1] > _TRIED_M and not fits):
        where = path.name or "the map"
        raise InputError(
            log.path,
            f"does not fit {where}: {usual:.0%} of the beams of a scan agree with it; the robot is never localized",
        )
