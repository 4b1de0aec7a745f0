"""One session: from its first scan until time jumps back, a reset or the end; and its output files."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Final, final

import numpy as np
from numpy.typing import NDArray

from gridslam.api.mapping import MapResult, finish_mapping
from gridslam.config import Configuration, build
from gridslam.doctor.repair import Repair
from gridslam.errors import ArgumentError, OutputError
from gridslam.io.digest import compute_digest
from gridslam.io.log_statistics import LogStatistics, Mounting
from gridslam.io.measurement import Measurement
from gridslam.io.results.record import RecordWriter
from gridslam.observers import StatisticsRecorder, TrajectoryRecorder
from gridslam.pipeline import Observer, Stopwatch, run
from gridslam.ros.node.accepted_scan import AcceptedScan
from gridslam.ros.node.recording import ScanRecorder
from gridslam.slam.grid_fastslam.state import GridFastSlamState
from gridslam.types import StepReport

__all__ = ["Session", "SessionCopy"]

_PRELOADED: Final = ("scipy.spatial", "scipy.sparse.csgraph", "scipy.special", "qdldl", "gridslam.viz")
"""Modules that filter and `save` import on first use; imported early so that a moving robot does not wait."""


@final
class Session:
    """A mapping session; used by the filter's thread only.

    Parameters
    ----------
    configuration : Configuration
        Configuration of the filter.
    seed, threads : int
        Seed and threads of the filter.
    record : Path or None
        File for the accepted scans.
    """

    restart_message = "starting a new map"

    def __init__(self, configuration: Configuration, seed: int, threads: int, record: Path | None) -> None:
        for name in _PRELOADED:
            import_module(name)
        self.configuration, self.seed, self.threads = configuration, seed, threads
        self.trajectory, self.statistics, self.log = TrajectoryRecorder(), StatisticsRecorder(), LogStatistics()
        self.stopwatch = Stopwatch()
        self.state: GridFastSlamState | None = None
        self._keys: list[tuple[StepReport, float]] = []
        self._recorder = None if record is None else ScanRecorder(record)

    @property
    def observers(self) -> list[Observer]:
        """The session's own observers."""
        return [self.trajectory, self.statistics, self._note]

    def run(self, source: Iterator[Measurement], observers: Sequence[Observer]) -> None:
        """Run the filter on all measurements of a source."""
        slam, rng = build(self.configuration, self.threads), np.random.default_rng(self.seed)
        first, *others = observers
        run(source, slam, rng=rng, observers=[first, *self.observers, *others], stopwatch=self.stopwatch)

    def add(self, accepted: AcceptedScan) -> None:
        """Record a measurement before the filter processes it; raises OutputError if it cannot be recorded."""
        scan, log = accepted.measurement.scan, self.log
        if scan.sensor not in log.mountings:
            yaw = accepted.laser.mounting[5]
            log.mountings[scan.sensor] = Mounting(np.append(scan.geometry.origin, yaw), f"tf, frame {scan.frame}")
        log.count(accepted.measurement)
        if self._recorder is not None:
            self._recorder.add(accepted)

    def copy(self) -> SessionCopy:
        """Copy everything that `save` needs; raises ArgumentError before the first scan."""
        if self.state is None:
            raise ArgumentError("session", "at least one scan", "none")
        recorder = self._recorder
        record = recorder.path if recorder is not None and recorder.is_whole else None
        return SessionCopy(
            self.configuration, self.seed, self.threads, self.state.to_arrays(), self.trajectory.to_arrays(),
            self.statistics.to_arrays(), copy.deepcopy(self.log), tuple(self._keys),
            copy.deepcopy(self.stopwatch.stages), record,
        )  # fmt: skip

    def close(self) -> None:
        """Close the record."""
        if self._recorder is not None:
            self._recorder.close()

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
    trajectory: Mapping[str, NDArray[Any]]
    statistics: Mapping[str, NDArray[Any]]
    log: LogStatistics
    keys: tuple[tuple[StepReport, float], ...]
    stages: dict[str, list[float]]
    record: Path | None

    def save(self, folder: str | Path) -> dict[str, Any]:
        """Write the files of `gridslam map` after the final refinement, which takes time; returns run.json's content.

        Raises
        ------
        OutputError
            The folder cannot be written.
        """
        result = self.result()
        try:
            return result.save(folder)
        except OSError as error:
            raise OutputError(f"{folder}: cannot be written: {error.strerror or error}") from None

    def result(self) -> MapResult:
        """Compute the full result, as `gridslam map` does at the end of a log."""
        watch = Stopwatch()
        watch.stages = self.stages
        record = RecordWriter()
        state = GridFastSlamState.from_arrays(self.state, self.configuration.mapper, self.threads)
        trajectory = TrajectoryRecorder.from_arrays(self.trajectory)
        for report, seconds in self.keys:
            record.add(report, seconds)
        return finish_mapping(
            state, trajectory, StatisticsRecorder.from_arrays(self.statistics), record, self.configuration,
            seed=self.seed, threads=self.threads, log=self.log, repair=Repair(), stopwatch=watch,
            source=Path(next(iter(self.log.scans))) if self.record is None else self.record,
            digest="" if self.record is None else compute_digest(self.record),
        )  # fmt: skip
