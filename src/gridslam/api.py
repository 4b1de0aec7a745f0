"""From a log to a map in one call."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, final

import numpy as np

from gridslam import __version__
from gridslam.config import Configuration, build
from gridslam.config import preset as preset_of
from gridslam.config.tables import to_table
from gridslam.errors import ArgumentError, InputError
from gridslam.io.carmen import CarmenLog
from gridslam.io.log_statistics import LogStatistics
from gridslam.io.map_server import write_map
from gridslam.io.measurement import Measurement
from gridslam.io.output import OutputFolder
from gridslam.io.record import RecordWriter
from gridslam.io.text_source import sha256_of
from gridslam.io.trajectory import write_tum
from gridslam.kernels import compiled
from gridslam.observers import RunStatistics, StatisticsRecorder, TrajectoryRecorder
from gridslam.pipeline import Observer, Stopwatch, run
from gridslam.slam.state import GridFastSlamState
from gridslam.types import OccupancyGrid, StepReport, Trajectory

__all__ = ["MapResult", "map_log", "peak_memory_bytes"]

RUN_SCHEMA = "gridslam.run/1"


@final
@dataclass(frozen=True, slots=True, eq=False)
class MapResult:
    """Map and trajectory of a log, and how they came about.

    Attributes
    ----------
    trajectory : Trajectory
        The full-SLAM answer: a pose of the best particle for every scan, at the scan's own stamp.
    online_trajectory : Trajectory
        The online-SLAM answer: what the best particle said at the time.
    map : OccupancyGrid
        Of the best particle.
    state : GridFastSlamState
        The filter after the last scan.
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
    record : RecordWriter
        The particles at each key scan.
    stopwatch : Stopwatch
        Time spent; saving goes on counting.
    """

    trajectory: Trajectory
    online_trajectory: Trajectory
    map: OccupancyGrid
    state: GridFastSlamState
    statistics: RunStatistics
    log: LogStatistics
    configuration: Configuration
    seed: int
    threads: int
    source: Path
    digest: str
    record: RecordWriter
    stopwatch: Stopwatch

    def save(self, folder: str | Path) -> dict[str, Any]:
        """Write all results into a folder, all of them or none; returns what run.json says.

        Raises
        ------
        OutputError
            The folder cannot be written.
        """
        with OutputFolder(folder) as out:
            return self.write(out)

    def write(self, out: OutputFolder, *, truth: Trajectory | None = None) -> dict[str, Any]:
        """Write all results into an open output folder; returns what run.json says.

        A true trajectory in the map's frame is drawn into the picture, too.
        """
        self.stopwatch.resume()
        write_map(out.file("map.yaml"), self.map)
        write_tum(out.file("trajectory.tum"), self.trajectory)
        write_tum(out.file("trajectory_online.tum"), self.online_trajectory)
        self.record.write(out.file("record.npz"))
        self.stopwatch.lap("write")
        from gridslam.viz import draw_map  # only drawing pays for the import of Pillow

        picture = draw_map(self.map, self.trajectory, title=self.source.name, caption=self.caption(), truth=truth)
        picture.save(out.file("map.png"), optimize=False)
        self.stopwatch.lap("draw")
        document = self.document()
        out.write_json("run.json", document)
        return document

    def caption(self) -> list[str]:
        """Lines that tell what was mapped."""
        height, width = (side * self.map.resolution_m for side in self.map.known.shape)
        log, wall = self.log, self.stopwatch.total()[0]
        return [
            f"{len(self.trajectory)} scans, {log.duration_s:.0f} s, {log.odometry_length_m:.0f} m driven",
            f"{width:.0f} m x {height:.0f} m in cells of {100 * self.map.resolution_m:g} cm",
            f"{self.configuration.particles} particles, seed {self.seed}, {wall:.1f} s: gridslam {__version__}",
        ]

    def document(self) -> dict[str, Any]:
        """What run.json says."""
        wall, cpu = self.stopwatch.total()
        stages = {name: {"wall_s": times[0], "cpu_s": times[1]} for name, times in self.stopwatch.stages.items()}
        return {
            "schema": RUN_SCHEMA,
            "version": __version__,
            "seed": self.seed,
            "threads": self.threads,
            "kernels": "compiled" if compiled else "reference",
            "input": _input(self.source, self.digest, self.log),
            "scans": _scans(self.statistics, self.log),
            "filter": _filter(self.statistics, self.state, self.map),
            "time": {"wall_s": wall, "cpu_s": cpu, "stages": stages},
            "latency": {"key_scans": asdict(self.statistics.key_latency), "all_scans": asdict(self.statistics.latency)},
            "peak_memory_bytes": peak_memory_bytes(),
            "configuration": to_table(self.configuration),
        }


def map_log(
    log: str | Path | CarmenLog,
    particles: int | None = None,
    seed: int = 0,
    *,
    preset: str = "default",
    configuration: Configuration | None = None,
    threads: int = 1,
    keep_truncated: bool = False,
    observers: Sequence[Observer] = (),
    stopwatch: Stopwatch | None = None,
) -> MapResult:
    """Map a CARMEN log with grid-based FastSLAM.

    Parameters
    ----------
    log : str, Path or CarmenLog
        The log.
    particles : int, optional
        Number of particles; the preset's own if not given. Not together with `configuration`.
    seed : int, >= 0
        The same log, configuration and seed give the same bytes.
    preset : str
        "default", "fast", "accurate" or "gmapping".
    configuration : Configuration, optional
        Instead of a preset.
    threads : int, >= 1
        Threads of the kernels; their number never changes a result.
    keep_truncated : bool
        Whether a log that is cut off is mapped as far as it goes instead of refused.
    observers : sequence of Observer
        Called after each scan.
    stopwatch : Stopwatch, optional
        To go on with.

    Raises
    ------
    ArgumentError
        The seed is negative, there is no thread, or both `particles` and `configuration` are given.
    InputError
        The log cannot be read, or has a scan without odometry.
    ConfigurationError
        There is no such preset, or the number of particles is out of range.
    """
    _check(seed, threads, particles, configuration)
    config = configuration or preset_of(preset, particles)
    watch = stopwatch or Stopwatch()
    source = log if isinstance(log, CarmenLog) else CarmenLog(log, keep_truncated=keep_truncated)
    trajectory, statistics, record = TrajectoryRecorder(), StatisticsRecorder(), RecordWriter()
    watch.lap("start")
    measurements, slam, rng = _with_odometry(source), build(config, threads), np.random.default_rng(seed)
    watched: list[Observer] = [trajectory, statistics, _kept_in(record), *observers]
    state = run(measurements, slam, particles=config.particles, rng=rng, observers=watched, stopwatch=watch)
    result = MapResult(
        trajectory=trajectory.full(state),
        online_trajectory=trajectory.online(),
        map=state.maps.occupancy(state.best),
        state=state,
        statistics=statistics.summary(),
        log=source.statistics,
        configuration=config,
        seed=seed,
        threads=threads,
        source=source.path,
        digest=sha256_of(source.path),
        record=record,
        stopwatch=watch,
    )
    watch.lap("finish")
    return result


def peak_memory_bytes() -> int:
    """Greatest memory that this process has held.

    What `getrusage` tells may be that of the process from which this one was started, so /proc is asked first.
    """
    try:
        lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
        return next(1024 * int(line.split()[1]) for line in lines if line.startswith("VmHWM:"))
    except (OSError, StopIteration, ValueError):
        import resource  # where there is no /proc

        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return peak if sys.platform == "darwin" else 1024 * peak


def _check(seed: int, threads: int, particles: int | None, configuration: Configuration | None) -> None:
    if seed < 0:
        raise ArgumentError("seed", "a number >= 0", seed)
    if threads < 1:
        raise ArgumentError("threads", "at least one", threads)
    if particles is not None and configuration is not None:
        raise ArgumentError("particles", "none where a configuration is given", particles)


def _kept_in(record: RecordWriter) -> Observer:
    def keep(report: StepReport, state: GridFastSlamState, seconds: float) -> None:
        record.add(report, seconds)

    return keep


def _with_odometry(log: CarmenLog) -> Iterator[Measurement]:
    for count, measurement in enumerate(log, 1):
        if measurement.odometry is None:
            raise InputError(log.path, f"expected odometry with every scan, got none for scan {count}")
        yield measurement


def _input(source: Path, digest: str, log: LogStatistics) -> dict[str, Any]:
    return {
        "path": os.fspath(source),
        "sha256": digest,
        "bytes": log.total_bytes,
        "truncated": log.truncated,
        "duration_s": log.duration_s,
        "odometry_length_m": log.odometry_length_m,
        "backward_stamps": log.backward_stamps,
        "duplicate_stamps": log.duplicate_stamps,
        "invalid_beams": log.invalid_beams,
        "no_return_beams": log.no_return_beams,
    }


def _scans(statistics: RunStatistics, log: LogStatistics) -> dict[str, Any]:
    return {
        "read": log.scan_count,
        "used": statistics.key_scans,
        "skipped": {reason.value: count for reason, count in statistics.skipped.items()},
        "lost": statistics.lost,
        "undetermined": statistics.undetermined,
    }


def _filter(statistics: RunStatistics, state: GridFastSlamState, grid: OccupancyGrid) -> dict[str, Any]:
    height, width = (side * grid.resolution_m for side in grid.known.shape)
    return {
        "particles": len(state.poses),
        "resamplings": statistics.resamplings,
        "n_eff_mean": statistics.n_eff_mean,
        "n_eff_min": statistics.n_eff_min,
        "map_width_m": width,
        "map_height_m": height,
        "maps_bytes": state.maps.nbytes,
    }
