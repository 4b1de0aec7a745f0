"""From a log to a map."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from gridslam.api.result import MapResult
from gridslam.arguments import require_instance, require_seed, require_threads
from gridslam.config import Configuration, apply_laser, build
from gridslam.config import preset as preset_of
from gridslam.doctor.repair import Repair, RepairedLog, open_repaired
from gridslam.errors import ArgumentError
from gridslam.io.log import Log, LogOptions, LogSource
from gridslam.io.measurement import Measurement
from gridslam.io.results.record import RecordWriter
from gridslam.io.text import compute_digest
from gridslam.observers import StatisticsRecorder, TrajectoryRecorder
from gridslam.pipeline import Observer, Stopwatch, run
from gridslam.slam.full_slam.full_slam import FullSlam, full_slam
from gridslam.slam.grid_fastslam.state import GridFastSlamState
from gridslam.types import StepReport, Trajectory

__all__ = ["map_log"]


def map_log(
    log: LogSource,
    particles: int | None = None,
    seed: int = 0,
    *,
    options: LogOptions | None = None,
    preset: str = "default",
    laser: str | None = None,
    configuration: Configuration | None = None,
    loop_closure: bool = True,
    threads: int = 1,
    repair: Literal["needed", "all", "none"] = "needed",
    observers: Sequence[Observer] = (),
    gate: Callable[[Iterable[Measurement]], Iterable[Measurement]] = iter,
    on_progress: Callable[[], None] = lambda: None,
    stopwatch: Stopwatch | None = None,
    keep_particles: bool = True,
) -> MapResult:
    """Map a log with grid-based FastSLAM and loop closure.

    Parameters
    ----------
    log : str, Path or Log
        The log, of any format that `open_log` knows.
    particles : int, optional
        Number of particles; the preset's own if not given. Not together with `configuration`.
    seed : int, >= 0
        The same log, configuration and seed give identical results.
    options : LogOptions, optional
        What to read of the log at a path.
    preset : str
        "default", "fast", "accurate" or "gmapping".
    laser : str, optional
        What the laser is, a name of `gridslam.config.LASERS`: limits and cells that suit it, over the preset.
    configuration : Configuration, optional
        Instead of a preset and a laser.
    loop_closure : bool
        False to disable loop closure, whatever the configuration.
    threads : int, >= 1
        Threads of the kernels; their number never changes a result.
    repair : "needed", "all" or "none"
        Faults of the log corrected before mapping: those that make any map unusable (a mirrored or misaligned laser),
        also clock offsets and odometry errors, or none. The result reports them.
    observers : sequence of Observer
        Called after each scan.
    gate : callable
        Gets the measurements on their way to the filter and gives them on, as they are, when they may go.
    on_progress : callable
        Called periodically during the final refinement, after the last scan.
    stopwatch : Stopwatch, optional
        To go on with.
    keep_particles : bool
        False: after the last scan the best particle alone is kept, so that the final refinement can use the memory of
        the others' maps. The result is the same.

    Raises
    ------
    ArgumentError
        The seed is negative, there is no thread, `configuration` and one of `particles` and `laser` are given, or
        both `options` and a log that is open already.
    InputError
        The log cannot be read.
    ConfigurationError
        There is no such preset or laser, or the number of particles is out of range.
    """
    _check(seed, threads, particles if laser is None else laser, configuration)
    config = configuration or preset_of(preset, particles)
    config = config if laser is None else apply_laser(config, laser)
    config = config if loop_closure else replace(config, loop_closure=None)
    watch = stopwatch or Stopwatch()
    source = open_repaired(log, options, repair)
    trajectory, statistics, record = TrajectoryRecorder(), StatisticsRecorder(), RecordWriter()
    watch.lap("start")
    slam, rng = build(config, threads), np.random.default_rng(seed)
    watched: list[Observer] = [trajectory, statistics, _kept_in(record), *observers]
    state = run(gate(source), slam, rng=rng, observers=watched, stopwatch=watch)
    maps_bytes = state.maps.nbytes
    if not keep_particles:
        state.keep_best()
    full = full_slam(
        state, trajectory.keys, trajectory.key_from_base, config.mapper, config.loop_closure, config.final_refinement,
        on_progress,
    )  # fmt: skip
    watch.lap("final refinement")
    return _result(full, state, maps_bytes, trajectory, statistics, record, source, config, seed, threads, watch)


def _result(
    full: FullSlam, state: GridFastSlamState, maps_bytes: int, trajectory: TrajectoryRecorder,
    statistics: StatisticsRecorder, record: RecordWriter, source: Log, config: Configuration, seed: int, threads: int,
    watch: Stopwatch,
) -> MapResult:  # fmt: skip
    """Put together what a run gives."""
    online = trajectory.online_trajectory()
    result = MapResult(
        trajectory=Trajectory(online.stamps_ns, full.poses),
        covariances=full.covariances,
        online_trajectory=online,
        tiled_map=full.tiled_map,
        graph=full.graph,
        loop_summary=full.loop_summary,
        key_stamps_ns=online.stamps_ns[np.flatnonzero(np.diff(trajectory.keys, prepend=-1))],
        state=state,
        maps_bytes=maps_bytes,
        statistics=statistics.summary(),
        log=source.statistics,
        configuration=config,
        seed=seed,
        threads=threads,
        source=source.path,
        digest=compute_digest(source.path),
        repair=(source.repair if isinstance(source, RepairedLog) else None) or Repair(),
        record=record,
        stopwatch=watch,
    )
    watch.lap("finish")
    return result


def _check(seed: int, threads: int, chosen: int | str | None, configuration: Configuration | None) -> None:
    require_seed(seed)
    require_threads(threads)
    require_instance("configuration", configuration, Configuration, optional=True)
    if chosen is not None and configuration is not None:
        raise ArgumentError("particles, laser", "none where a configuration is given", chosen)


def _kept_in(record: RecordWriter) -> Observer:
    def keep(report: StepReport, state: GridFastSlamState, seconds: float) -> None:
        record.add(report, seconds)

    return keep
