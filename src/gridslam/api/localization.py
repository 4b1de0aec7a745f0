"""From a log and a map to the robot's way in it: Monte Carlo localization, its result and its output files."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridslam import __version__
from gridslam.api.result import ScanResult, find_repair, write_trajectory
from gridslam.arguments import describe, require_instance, require_seed, require_threads
from gridslam.checked import checked
from gridslam.doctor.repair import open_repaired
from gridslam.errors import ArgumentError, InputError
from gridslam.io.log import Log, LogOptions, LogSource
from gridslam.io.maps import read_map
from gridslam.io.measurement import Measurement
from gridslam.io.output import OutputFolder
from gridslam.io.text import compute_digest
from gridslam.localization.known_map import KnownMap
from gridslam.localization.monte_carlo import MonteCarloConfiguration, MonteCarloLocalization
from gridslam.localization.state import (
    LocalizationObserver,
    LocalizationReport,
    LocalizationSkip,
    MonteCarloState,
)
from gridslam.parameters import to_table
from gridslam.pipeline import FailureRecorder, Stopwatch, run
from gridslam.types import FloatArray, IntArray, OccupancyGrid, Odometry, Trajectory
from gridslam.viz import draw_localization
from gridslam.viz.notebook import Picture

if TYPE_CHECKING:
    from gridslam.api.mapping import MapResult

BELIEF_HEADER = "stamp_s,lost,lost_probability,inlier_ratio,particles,n_eff,injection_ratio"
"""First line of belief.csv: a row for each scan; n_eff is empty where the particles were not updated."""

INITIAL_COVARIANCE: FloatArray = np.diag([0.25, 0.25, (math.pi / 12) ** 2])
"""Default covariance of an initial pose: 0.5 m and 15 degrees, as in AMCL."""

_FOUND = 0.2
"""Found at a smaller share of the scans on a way of `_TRIED_M`: the log is of somewhere else."""
_TRIED_M = 5.0


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
@dataclass(frozen=True, slots=True, eq=False, repr=False, kw_only=True)
class LocalizationResult(ScanResult):
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
    map_path : Path
        The map's YAML file or, for a map that was given as such, an empty path.
    remarks : tuple of str
        What is odd about the map's file.
    """

    schema: ClassVar = "gridslam.localization/2"
    picture_name: ClassVar = "localization.png"
    file_names: ClassVar = ("trajectory.tum", "trajectory.csv", "belief.csv", "history.npz")

    reports: list[LocalizationReport]
    driven_m: FloatArray
    map: OccupancyGrid
    state: MonteCarloState
    configuration: MonteCarloConfiguration
    pose: FloatArray | None
    seed: int
    threads: int
    map_path: Path
    remarks: tuple[str, ...]

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
        """Return where the robot was found and where it was lost, in order."""
        lost = self.lost
        begins = np.flatnonzero(np.diff(lost, prepend=~lost[:1]))
        ends = np.append(begins[1:], len(lost)) - 1
        pairs = zip(begins.tolist(), ends.tolist(), strict=True)
        return [LocalizationInterval(bool(lost[a]), a, b, float(self.driven_m[a])) for a, b in pairs]

    def warnings(self) -> Iterator[str]:
        """Yield warnings about log and map, a sentence each."""
        for fault in self.repair.describe():
            yield f"{self.source}: {fault}: corrected (disable with --repair none; details: gridslam doctor)"
        yield from (f"{self.map_path}: {remark}" for remark in self.remarks)
        if self.lost.all():
            yield (
                f"{self.source}: the robot was never localized with confidence: the drive is too short, or the "
                "map is ambiguous"
            )

    def caption(self) -> list[str]:
        """Return lines that describe the result."""
        scans = len(self.reports)
        found = next((interval for interval in self.intervals() if not interval.lost), None)
        where = "never found" if found is None else f"found after {found.driven_m:.1f} m"
        start = where if self.pose is None else f"begun at {', '.join(f'{v:g}' for v in self.pose)}"
        return [
            f"{scans} scans, {self.log.duration_s:.0f} s, {self.driven_m[-1]:.0f} m driven",
            f"{start}; lost at {self.lost.sum()} of {scans} scans",
            f"seed {self.seed}, {self.stopwatch.total()[0]:.1f} s: gridslam {__version__}",
        ]

    def picture(self) -> Picture:
        """Draw the map with the trajectory, and where the robot was lost."""
        return draw_localization(self.map, self.trajectory, self.lost, title=self.source.name, caption=self.caption())

    def _write_files(self, out: OutputFolder) -> None:
        write_trajectory(out, self.trajectory, self.covariances)
        out.file("belief.csv").write_text("\n".join([BELIEF_HEADER, *self._belief(), ""]), encoding="ascii")

    def _belief(self) -> Iterator[str]:
        for r in self.reports:
            n_eff = f"{r.n_eff:.1f}" if r.skipped is None else ""
            whole, rest = divmod(r.stamp_ns, 10**9)
            yield (
                f"{whole}.{rest:09d},{r.lost:d},{r.lost_probability:.6g},{r.inlier_ratio:.4f},{r.particles},{n_eff},"
                f"{r.injection_ratio:.4g}"
            )

    def _describe(self) -> dict[str, Any]:
        stamps_ns = self.stamps_ns
        reasons = [report.skipped for report in self.reports]
        updates = [report for report in self.reports if report.skipped is None]
        return {
            "seed": self.seed,
            "threads": self.threads,
            "input": {
                **self.describe_input(),
                "map": os.fspath(self.map_path),
                "map_remarks": list(self.remarks),
                "odometry_length_m": float(self.driven_m[-1]),
            },
            "initial_pose": "global" if self.pose is None else self.pose.tolist(),
            "scans": {
                "read": len(reasons),
                "used": len(updates),
                "skipped": {reason.value: reasons.count(reason) for reason in LocalizationSkip if reason in reasons},
                "lost": int(self.lost.sum()),
                "odometry_rejected": sum(report.odometry_rejected for report in self.reports),
            },
            "filter": {
                "particles_mean": float(np.mean([report.particles for report in updates])),
                "particles_max": max(report.particles for report in updates),
                "n_eff_mean": float(np.mean([report.n_eff for report in updates])),
                "inlier_ratio_mean": float(np.mean([report.inlier_ratio for report in updates])),
                "injected_updates": sum(report.injection_ratio > 0 for report in updates),
            },
            "intervals": [
                {
                    "lost": interval.lost,
                    "stamps_ns": stamps_ns[[interval.first, interval.last]].tolist(),
                    "driven_m": interval.driven_m,
                }
                for interval in self.intervals()
            ],
            "configuration": to_table(self.configuration),
        }


@checked
def localize(
    log: LogSource,
    map: str | Path | OccupancyGrid | KnownMap | MapResult,
    *,
    pose: ArrayLike | None = None,
    covariance: ArrayLike = INITIAL_COVARIANCE,
    strict_thresholds: bool = False,
    configuration: MonteCarloConfiguration | None = None,
    seed: int = 0,
    threads: int = 1,
    options: LogOptions | None = None,
    repair: Literal["needed", "none"] = "needed",
    observers: Sequence[LocalizationObserver] = (),
    gate: Callable[[Iterable[Measurement]], Iterable[Measurement]] = iter,
    on_progress: Callable[[], None] = lambda: None,
    stopwatch: Stopwatch | None = None,
    digest: str | None = None,
) -> LocalizationResult:
    """Localize the robot of a log in a map, by Monte Carlo localization.

    Parameters
    ----------
    log : str, Path or Log
        The log, of any format that `open_log` knows.
    map : str, Path, OccupancyGrid, KnownMap or MapResult
        The map: the YAML file of map_server or nav2, a map at hand, or the result of `map_log`.
    pose : (3,) float64, optional
        Where the robot is at the first scan, map frame [x m, y m, theta rad]; it is found if not given.
    covariance : (3, 3) float64, m^2, m rad, rad^2
        Of that pose.
    strict_thresholds : bool
        Read the thresholds of the map's file literally (see `gridslam.io.maps.read_map`).
    configuration : MonteCarloConfiguration, optional
        Of the filter.
    seed : int, >= 0
        The same log, map, parameters and seed give identical results.
    threads : int, >= 1
        Threads of the kernels; their number never changes a result.
    options : LogOptions, optional
        What to read of the log at a path.
    repair : "needed" or "none"
        As for `gridslam.map_log`: what is taken out of the log.
    observers : sequence of LocalizationObserver
        Called after each scan.
    gate : callable
        Gets the measurements on their way to the filter and gives them on, as they are, when they may go.
    on_progress : callable
        Called after each scan.
    stopwatch : Stopwatch, optional
        A stopwatch to continue.
    digest : str, optional
        SHA-256 of the log, where it is known (see `gridslam.io.text.compute_digest`).

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
    _require_map(map)
    require_instance("configuration", configuration, MonteCarloConfiguration, optional=True)
    watch = stopwatch or Stopwatch()
    configuration = configuration or MonteCarloConfiguration()
    source = open_repaired(log, options, repair)
    path, known, remarks = known_map(map, configuration, threads, strict_thresholds=strict_thresholds)
    rng = np.random.default_rng(seed)
    mcl = MonteCarloLocalization(known, configuration)
    state = mcl.init() if pose is None else mcl.init_gaussian(pose, covariance, rng)
    watch.lap("start")
    reports = list[LocalizationReport]()
    steps_m = list[float]()
    last: Odometry | None = None

    def note(report: LocalizationReport, state: MonteCarloState, seconds: float) -> None:
        """Keep a report without particles, and the way since the scan before."""
        nonlocal last
        reports.append(replace(report, poses=None, log_weights=None, parents=None))
        moved = None if last is None or state.last is None else state.last.pose - last.pose
        steps_m.append(0.0 if moved is None else float(np.hypot(moved[0], moved[1])))
        last = state.last
        on_progress()

    failures = FailureRecorder()
    state = run(
        gate(source),
        mcl,
        rng=rng,
        observers=[*observers, note],
        state=state,
        stopwatch=watch,
        on_failure=failures,
    )
    driven_m = np.cumsum(steps_m)
    _check_found(source, path, reports, driven_m, configuration)
    result = LocalizationResult(
        reports=reports,
        driven_m=driven_m,
        map=known.grid,
        state=state,
        configuration=configuration,
        pose=None if pose is None else np.array(pose, np.float64),
        seed=seed,
        threads=threads,
        log=source.statistics,
        source=source.path,
        map_path=path,
        digest=digest or compute_digest(source.path),
        remarks=remarks,
        repair=find_repair(source),
        stopwatch=watch,
        failures=failures.describe(),
    )
    watch.lap("finish")
    return result


def _require_map(source: object) -> None:
    """Check that a value is a map, or has one as the results of `map_log` have; this module does not import these."""
    if not isinstance(source, str | os.PathLike | OccupancyGrid | KnownMap) and not hasattr(source, "tiled_map"):
        raise ArgumentError("map", "str or Path or OccupancyGrid or KnownMap or MapResult", describe(source))


def known_map(
    source: str | Path | OccupancyGrid | KnownMap | MapResult,
    configuration: MonteCarloConfiguration,
    threads: int = 1,
    *,
    strict_thresholds: bool = False,
) -> tuple[Path, KnownMap, tuple[str, ...]]:
    """Read a map; return it with its path (empty for a map in memory) and remarks about its file.

    Raises InputError where a file is no map in which a robot could be.
    """
    if isinstance(source, KnownMap):
        return Path(), source, ()
    if not isinstance(source, str | os.PathLike):
        grid = source if isinstance(source, OccupancyGrid) else source.map
        return Path(), KnownMap(grid, reach_m=configuration.reach_m, threads=threads), ()
    remarks = list[str]()
    grid = read_map(source, strict_thresholds=strict_thresholds, on_remark=remarks.append)
    try:
        return Path(source), KnownMap(grid, reach_m=configuration.reach_m, threads=threads), tuple(remarks)
    except ArgumentError as error:
        raise InputError(source, str(error).removeprefix("map: ")) from None


def _check_found(
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
    ratios = [report.inlier_ratio for report in updates]
    usual = float(np.median(ratios))
    found = np.mean([not report.lost for report in reports])
    sought = np.mean([report.injection_ratio > 0 for report in updates])  # all over the map, again and again
    fits = usual >= configuration.recovery.expected and sought < 0.5
    if max(ratios) < configuration.lost_below or (found < _FOUND and driven_m[-1] > _TRIED_M and not fits):
        where = path.name or "the map"
        raise InputError(
            log.path,
            f"does not fit {where}: {usual:.0%} of the beams of a scan agree with it; the robot is never localized",
        )
