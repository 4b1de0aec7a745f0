"""One session of the filter: from its first scan until time jumps back, a reset or the end; and its output files."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Final, TypeAlias, final

import numpy as np
from numpy.typing import NDArray

from gridslam.api.mapping import MapResult, finish_mapping
from gridslam.config import Configuration, build
from gridslam.doctor.repair import Repair
from gridslam.errors import ArgumentError, OutputError
from gridslam.io.log_statistics import LogStatistics, Mounting
from gridslam.io.measurement import Measurement
from gridslam.io.results.record import RecordWriter
from gridslam.io.sessions.session_file import SavedRun
from gridslam.io.text import compute_digest
from gridslam.localization import (
    KnownMap,
    LocalizationReport,
    MonteCarloConfiguration,
    MonteCarloLocalization,
    MonteCarloState,
)
from gridslam.observers import StatisticsRecorder, TrajectoryRecorder
from gridslam.pipeline import FailedStep, FailureRecorder, Observer, Stopwatch, run
from gridslam.ros.node.accepted_scan import AcceptedScan
from gridslam.slam.grid_fastslam.state import GridFastSlamState
from gridslam.types import FloatArray, LaserScan, Odometry, StepReport

__all__ = [
    "FailureCallback",
    "InitialPose",
    "Localization",
    "LocalizationSession",
    "Session",
    "SessionCopy",
    "WaitingSession",
]

FailureCallback: TypeAlias = Callable[[FailedStep], None]
"""Called with each step that failed."""

InitialPose: TypeAlias = tuple[FloatArray, FloatArray] | None
"""A pose (3,) and its covariance (3, 3); None if the pose is unknown."""

_PRELOADED: Final = ("scipy.spatial", "scipy.sparse.csgraph", "scipy.special", "qdldl", "gridslam.viz")
"""Modules that filter and `save` import on first use; imported early so that a moving robot does not wait."""


@final
@dataclass(frozen=True, slots=True, eq=False)
class Localization:
    """Map, filter and initial pose of a localization.

    Attributes
    ----------
    known : KnownMap or None
        The map; None until one comes as a message.
    configuration : MonteCarloConfiguration
        Configuration of the filter.
    initial_pose : (pose (3,), covariance (3, 3)) or None
        Initial pose; None: global localization.
    """

    known: KnownMap | None
    configuration: MonteCarloConfiguration
    initial_pose: InitialPose = None

    @property
    def range_max_m(self) -> float:
        """Range from which beams are ignored, m."""
        return self.configuration.range_max_m


@final
class LocalizationSession:
    """A localization session; used by the filter's thread only.

    Parameters
    ----------
    localization : Localization
        Map and filter.
    seed : int
        Seed of the filter.
    """

    restart_message = "localization restarts"

    def __init__(self, localization: Localization, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        assert localization.known is not None
        self._mcl = MonteCarloLocalization(localization.known, localization.configuration)
        self.state = self._make_state(localization.initial_pose)
        self._next_state: MonteCarloState | None = None
        self._updates_always = False

    def update_once(self) -> None:
        """Update the particles at the next scan, even if the robot does not move."""
        self._updates_always = True

    def set_pose(self, pose: InitialPose) -> None:
        """Set the pose from the next scan on; None: the pose is unknown."""
        self._next_state = self._make_state(pose)

    def add(self, accepted: AcceptedScan) -> None:
        """Do nothing: a localization has no files, in which scans are counted."""

    def copy(self, record: Path | None) -> SessionCopy:
        """Raise ArgumentError: a localization has no map to save."""
        raise ArgumentError("save", "a node that maps", "one that localizes; `gridslam localize` takes its record")

    def run(self, source: Iterator[Measurement], observers: Sequence[Any], on_failure: FailureCallback) -> None:
        """Run the filter on all measurements of a source; scans at which it fails are skipped."""
        run(
            source,
            self,
            rng=self._rng,
            observers=observers,
            state=self.state,
            on_failure=on_failure,
        )

    def step(
        self, state: MonteCarloState, odometry: Odometry | None, scan: LaserScan, rng: np.random.Generator
    ) -> tuple[MonteCarloState, LocalizationReport]:
        """Process a measurement, from the pose that was set since the last scan if there is one."""
        begin = state if self._next_state is None else self._next_state.snapshot()
        self.state, report = self._mcl.step(begin, odometry, scan, rng, always=self._updates_always)
        self._next_state = None
        self._updates_always = self._updates_always and report.log_weights is None
        return self.state, report

    def _make_state(self, pose: InitialPose) -> MonteCarloState:
        return self._mcl.init() if pose is None else self._mcl.init_gaussian(*pose, self._rng)


@final
class WaitingSession:
    """A localization without a map: no scan is processed."""

    restart_message = "localization starts"
    state = None

    def add(self, accepted: AcceptedScan) -> None:
        """Do nothing."""

    def copy(self, record: Path | None) -> SessionCopy:
        """Raise ArgumentError: there is nothing to save."""
        raise ArgumentError("save", "a node that maps", "one that waits for a map to localize in")

    def run(self, source: Iterator[Measurement], observers: Sequence[Any], on_failure: FailureCallback) -> None:
        """Drop all scans."""
        for _ in source:
            pass


@final
class Session:
    """A mapping session; used by the filter's thread only.

    Parameters
    ----------
    configuration : Configuration
        Configuration of the filter.
    seed, threads : int
        Seed and threads of the filter.
    """

    restart_message = "starting a new map"

    def __init__(self, configuration: Configuration, seed: int, threads: int) -> None:
        for name in _PRELOADED:
            import_module(name)
        self.state: GridFastSlamState | None = None
        self._configuration = configuration
        self._seed = seed
        self._threads = threads
        self._trajectory = TrajectoryRecorder()
        self._statistics = StatisticsRecorder()
        self._log = LogStatistics()
        self._stopwatch = Stopwatch()
        self._keys: list[tuple[StepReport, float]] = []
        self._failures = FailureRecorder()

    def add(self, accepted: AcceptedScan) -> None:
        """Count a measurement before the filter processes it."""
        scan = accepted.measurement.scan
        if scan.sensor not in self._log.mountings:
            pose = np.append(scan.geometry.origin, accepted.mounting[5])
            self._log.mountings[scan.sensor] = Mounting(pose, f"tf, frame {scan.frame}")
        self._log.count(accepted.measurement)

    def run(self, source: Iterator[Measurement], observers: Sequence[Observer], on_failure: FailureCallback) -> None:
        """Run the filter on all measurements of a source; scans at which it fails are skipped."""
        slam = build(self._configuration, self._threads)
        rng = np.random.default_rng(self._seed)
        first, *others = observers
        every = [first, self._trajectory, self._statistics, self._note, *others]

        def note_failure(failed: FailedStep) -> None:
            self.state = failed.state
            self._failures(failed)
            on_failure(failed)

        run(source, slam, rng=rng, observers=every, stopwatch=self._stopwatch, on_failure=note_failure)

    def copy(self, record: Path | None) -> SessionCopy:
        """Copy everything that `save` needs; raises ArgumentError before the first scan.

        `record` is the file with all scans so far, None if there is none.
        """
        if self.state is None:
            raise ArgumentError("session", "at least one scan", "none")
        return SessionCopy(
            self._configuration,
            self._seed,
            self._threads,
            self.state.to_arrays(),
            *copy.deepcopy((self._trajectory, self._statistics, self._log, self._stopwatch)),
            tuple(self._keys),
            record,
            self._failures.describe(),
        )

    def _note(self, report: StepReport, state: GridFastSlamState, seconds: float) -> None:
        self.state = state
        if report.skipped is None:
            self._keys.append((report, seconds))


@final
@dataclass(frozen=True, slots=True, eq=False)
class SessionCopy:
    """A copy of a session that shares nothing with the running filter."""

    configuration: Configuration
    seed: int
    threads: int
    state: Mapping[str, NDArray[Any]]
    trajectory: TrajectoryRecorder
    statistics: StatisticsRecorder
    log: LogStatistics
    stopwatch: Stopwatch
    keys: tuple[tuple[StepReport, float], ...]
    record: Path | None
    failures: tuple[str, ...]

    def save(self, folder: str | Path) -> dict[str, Any]:
        """Write the files of `gridslam map` after the final refinement, which takes time; returns run.json's content.

        Raises
        ------
        OutputError
            The folder cannot be written.
        """
        result = self._compute_result()
        try:
            return result.save(folder)
        except OSError as error:
            raise OutputError(f"{folder}: cannot be written: {error.strerror or error}") from None

    def _compute_result(self) -> MapResult:
        """Compute the full result, as `gridslam map` does at the end of a log."""
        record = RecordWriter()
        for report, seconds in self.keys:
            record.add(report, seconds)
        self.stopwatch.resume()
        run = SavedRun(
            np.random.default_rng(self.seed),
            GridFastSlamState.from_arrays(self.state, self.configuration.mapper, self.threads),
            self.trajectory,
            self.statistics,
            record,
        )
        return finish_mapping(
            run,
            self.configuration,
            seed=self.seed,
            threads=self.threads,
            log=self.log,
            source=Path(next(iter(self.log.scans))) if self.record is None else self.record,
            digest="" if self.record is None else compute_digest(self.record),
            repair=Repair(),
            stopwatch=self.stopwatch,
            failures=self.failures,
        )
