"""From a log to a map: grid-based FastSLAM with loop closure, its result and its output files."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any, ClassVar, Literal, final

import numpy as np

from gridslam import __version__
from gridslam.api.beginning import Beginning, begin_new_piece
from gridslam.api.peak_memory import find_peak_memory_bytes
from gridslam.api.result import ScanResult, find_repair, write_trajectory
from gridslam.arguments import require_instance, require_seed, require_threads
from gridslam.checked import checked
from gridslam.config import Configuration, apply_laser, build
from gridslam.config import preset as preset_of
from gridslam.doctor.finding import Finding
from gridslam.doctor.repair import Repair, open_repaired
from gridslam.doctor.view_breaks import split_where_carried
from gridslam.errors import ArgumentError
from gridslam.grid.tiles import TiledGrid
from gridslam.io.g2o import write_g2o
from gridslam.io.log import LogOptions, LogSource
from gridslam.io.log_statistics import LogStatistics
from gridslam.io.maps import write_map
from gridslam.io.measurement import Measurement
from gridslam.io.output import OutputFolder
from gridslam.io.sessions.drives import Drive, DrivenLog, SavedPiece
from gridslam.io.sessions.session_file import SavedRun, SavedSession
from gridslam.io.text import compute_digest
from gridslam.io.trajectories import write_tum
from gridslam.kernels import compiled
from gridslam.observers import RunStatistics
from gridslam.parameters import to_table
from gridslam.pipeline import Observer, Stopwatch, describe_error, run
from gridslam.slam.full_slam.full_slam import LoopClosureSummary, full_slam
from gridslam.slam.grid_fastslam.state import GridFastSlamState
from gridslam.slam.loop_closure.constraints import ConstraintSource
from gridslam.slam.loop_closure.state import LoopClosureState, RejectionReason
from gridslam.slam.pose_graph.pose_graph import PoseGraph
from gridslam.tracking.tracker import Tracker, TrackerState
from gridslam.types import FloatArray, IntArray, OccupancyGrid, Trajectory
from gridslam.viz import draw_map
from gridslam.viz.notebook import Picture

_OWN_PARTS = "tracker", "motion", "sensor", "proposal", "resampler", "when_to_update", "when_to_resample"
_MAX_BACKWARD_RATIO = 0.1
"""Ratio of scans stamped before their predecessor above which a warning is given; jitter causes up to 0.05."""
_ORDERS = {1: "as reported", 0: "none", -1: "backward"}


@final
@dataclass(frozen=True, slots=True)
class FoundAgain:
    """How a drive was found in the map of earlier ones.

    Attributes
    ----------
    drives : tuple of str
        Names of the earlier ones.
    stamp_ns : int, ns
        Stamp of the scan at which it was certain.
    way_m : float, m
        Length of the way from the beginning of the drive to there.
    """

    drives: tuple[str, ...]
    stamp_ns: int
    way_m: float


@final
@checked
@dataclass(frozen=True, slots=True, eq=False, repr=False, kw_only=True)
class MapResult(ScanResult):
    """Map and trajectory of a log, and how they came about.

    Attributes
    ----------
    trajectory : Trajectory
        The full SLAM trajectory: the pose of every scan given all measurements, at the scan's own stamp.
    covariances : (N, 3, 3) float64
        Of its poses, by x, y in m and theta in rad, map frame, given that the first pose is exact.
    online_trajectory : Trajectory
        The online trajectory: the pose of the best particle at each scan, smoothed over its matches.
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
    configuration : Configuration
        The effective one.
    seed, threads : int
        As given.
    truth : Trajectory or None
        The true trajectory in the map's frame, where it is known; it is drawn into the picture.
    map_piece : SavedPiece or None
        The map as a piece of a session, with its drives; None without loop closure, and if only the
        best particle was kept.
    drives : tuple of Drive
        The drives in the map, in the order of their key scans; none without loop closure.
    run : SavedRun or None
        The filter and its observers after the last scan; None if only the best particle was kept.
    pieces : tuple of SavedPiece
        Pieces that were not joined with this map: of the continued session, and of the log itself where the robot was
        carried.
    found_again : FoundAgain or None
        Where the robot was relocalized in maps of earlier drives; None if it was not looked for, or not found.
    own_parts : mapping of str to str
        Classes of the parts of the filter that `map_log` was given instead of the configuration's.
    """

    schema: ClassVar = "gridslam.run/3"
    picture_name: ClassVar = "map.png"
    file_names: ClassVar = (
        *("map.yaml", "map.pgm", "trajectory.tum", "trajectory.csv"),
        *("trajectory_online.tum", "graph.g2o", "history.npz"),
    )

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
    configuration: Configuration
    seed: int
    threads: int
    truth: Trajectory | None = None
    map_piece: SavedPiece | None = None
    drives: tuple[Drive, ...] = ()
    run: SavedRun | None = None
    pieces: tuple[SavedPiece, ...] = ()
    found_again: FoundAgain | None = None
    own_parts: Mapping[str, str] = field(default_factory=dict)

    @property
    def trajectories(self) -> dict[str, Trajectory]:
        """The trajectory of each drive in this map, by its name."""
        drives = self.drives
        trajectory = self.trajectory
        if len(drives) < 2:
            return {(drives[0].name if drives else self.source.stem): trajectory}
        own = np.repeat(np.arange(len(drives)), [len(drive.stamps_ns) for drive in drives])[_sort_scans(drives)]
        return {
            drive.name: Trajectory(trajectory.stamps_ns[own == number], trajectory.poses[own == number])
            for number, drive in enumerate(drives)
        }

    @property
    def map(self) -> OccupancyGrid:
        """The map as one array, built at each access."""
        return self.tiled_map.whole()

    @property
    def driven(self) -> str:
        """Odometry path length as text."""
        log = self.log
        return "no odometry" if log.without_odometry == log.scan_count else f"{log.odometry_length_m:.0f} m driven"

    @property
    def poses_by_drive(self) -> FloatArray:
        """The poses of `trajectory` (N, 3), one drive after the other."""
        if len(self.drives) < 2:
            return self.trajectory.poses
        poses = np.empty_like(self.trajectory.poses)
        poses[_sort_scans(self.drives)] = self.trajectory.poses
        return poses

    def to_session(self) -> SavedSession:
        """Return a session that later logs can continue; save it by `Session.save`.

        Raises ArgumentError where only the best particle was kept.
        """
        if self.run is None:
            raise ArgumentError(
                "result", "one of all particles (keep_particles=True)", "one of the best particle alone"
            )
        return SavedSession(self.configuration, self.seed, self.run, self.pieces)

    def warnings(self) -> Iterator[str]:
        """Yield warnings about the log, a sentence each."""
        log = self.log
        yield from self.describe_faults()
        if log.backward_stamps > _MAX_BACKWARD_RATIO * log.scan_count:
            yield (
                f"{log.backward_stamps} of {log.scan_count} scans have a stamp older than their predecessor: "
                "check the order of the log"
            )
        beams = sum(count * scans for count, scans in log.beam_counts.items())
        if log.invalid_beams > 0.5 * beams:
            yield f"{log.invalid_beams} of {beams} ranges are invalid (zero, negative or not a number)"

    def caption(self) -> list[str]:
        """Return lines that describe the map."""
        height, width = (side * self.tiled_map.resolution_m for side in self.tiled_map.shape)
        wall = self.stopwatch.total()[0]
        places = ""
        loops = self.loop_summary
        if loops is not None:
            kinds = f"{len(loops.closures)} recognized, {len(loops.tracked_revisits)} tracked"
            drawn = f", {len(loops.shown)} drawn" if len(loops.shown) < loops.count else ""
            places = f", {loops.count} loop closure{'s' * (loops.count != 1)} ({kinds}{drawn})"
        drives = len(self.drives)
        together = f"{len(self.trajectory)} scans of {drives} drives; the last: " if drives > 1 else ""
        scans = self.log.scan_count if drives > 1 else len(self.trajectory)
        return [
            f"{together}{scans} scans, {self.log.duration_s:.0f} s, {self.driven}{places}",
            f"{width:.0f} m x {height:.0f} m in cells of {100 * self.tiled_map.resolution_m:g} cm",
            f"{self.configuration.particles} particles, seed {self.seed}, {wall:.1f} s: gridslam {__version__}",
        ]

    def closure_ends(self, pairs: IntArray) -> FloatArray:
        """Return ends (K, 4) of loop closures, x0, y0, x1, y1 in m, map frame, from their pairs (K, 2) of key scans."""
        ends: FloatArray = self.graph.poses[pairs, :2].reshape(-1, 4)
        return ends

    def picture(self) -> Picture:
        """Draw the map with the trajectory, its closures, and the true trajectory where it is known."""
        return draw_map(
            self.tiled_map,
            self.trajectories if len(self.trajectories) > 1 else self.trajectory,
            title=self.source.name,
            caption=self.caption(),
            truth=self.truth,
            closures=None if self.loop_summary is None else self.closure_ends(self.loop_summary.shown),
        )

    def _write_files(self, out: OutputFolder) -> None:
        write_map(out.file("map.yaml"), self.tiled_map)
        write_trajectory(out, self.trajectory, self.covariances)
        trajectories = self.trajectories
        if len(trajectories) > 1:
            for name, trajectory in trajectories.items():
                write_tum(out.file(f"trajectory_{name}.tum"), trajectory)
        for number, apart in enumerate(self.pieces, start=2):
            for name, trajectory in apart.trajectories.items():
                write_tum(out.file(f"trajectory_{name}.tum"), trajectory)
            write_map(out.file(f"map_{number}.yaml"), apart.piece.build_map(self.configuration.mapper).tiled(0))
        write_tum(out.file("trajectory_online.tum"), self.online_trajectory)
        write_g2o(out.file("graph.g2o"), self.graph)

    def _describe(self) -> dict[str, Any]:
        statistics = self.statistics
        return {
            "seed": self.seed,
            "threads": self.threads,
            "kernels": "compiled" if compiled else "reference",
            "input": self._describe_input(),
            "session": self._describe_session(),
            "scans": self._describe_scans(),
            "tracker": self._describe_tracker(),
            "filter": self._describe_filter(),
            "loop_closure": self.loop_summary is not None and self._describe_loop_closure(self.loop_summary),
            "latency": {"key_scans": asdict(statistics.key_latency), "all_scans": asdict(statistics.latency)},
            "peak_memory_bytes": find_peak_memory_bytes(),
            "configuration": to_table(self.configuration),
            "own_parts": dict(self.own_parts),
        }

    def _describe_input(self) -> dict[str, Any]:
        log = self.log
        sensors = {
            sensor: {
                "base_from_laser": mounting.pose.tolist(),
                "source": mounting.source,
                "moved": log.moving_mountings[sensor],  # scans at which it had changed since the first
            }
            for sensor, mounting in log.mountings.items()
        }
        return self.describe_input() | {
            "bytes": log.total_bytes,
            "truncated": log.truncated,
            "sensors": sensors,
            "odometry": log.odometry_source,
            "without_odometry": log.without_odometry,
            "odometry_length_m": log.odometry_length_m,
            "backward_stamps": log.backward_stamps,
            "duplicate_stamps": log.duplicate_stamps,
            "invalid_beams": log.invalid_beams,
            "no_return_beams": log.no_return_beams,
            "missing_transforms": dict(log.missing_transforms),
            "remarks": dict(log.remarks),
            "faults": dict(log.faults),
        }

    def _describe_session(self) -> dict[str, Any] | None:
        """Describe the session that the map continues; None for a single log."""
        drives = self.drives
        logs = [log for drive in drives for log in drive.logs]
        if len(logs) < 2 and not self.pieces and self.found_again is None:
            return None
        return {
            "drives": [{"name": drive.name, "logs": [asdict(log) for log in drive.logs]} for drive in drives],
            "found_again": None if self.found_again is None else asdict(self.found_again),
            "apart": [[drive.name for drive in piece.drives] for piece in self.pieces],
        }

    def _describe_scans(self) -> dict[str, Any]:
        statistics = self.statistics
        before = () if self.run is None else self.run.logs[:-1]
        return {
            "read": self.log.scan_count + sum(log.scans for log in before),
            "used": statistics.key_scans,
            "skipped": {reason.value: count for reason, count in statistics.skipped.items()},
            "lost": statistics.lost,
            "degenerate": statistics.degenerate,
        }

    def _describe_tracker(self) -> dict[str, Any] | None:
        """Summary of the tracker; None for the tracker that uses the odometry unchanged."""
        tracker = self.configuration.tracker
        if not isinstance(tracker, Tracker):
            return None
        state = self.state.tracker
        timed = {sensor: track for sensor, track in state.sensors.items() if track.beam_order.scans}
        has_odometry = self.log.without_odometry < self.log.scan_count
        return {
            "odometry": _describe_odometry_errors(state) if has_odometry else None,
            "odometry_rejected": state.rejected_odometry,
            "stamps_reliable": not state.stamps_unreliable,
            "beam_order": {sensor: _ORDERS[track.best_order] for sensor, track in timed.items()},
        }

    def _describe_filter(self) -> dict[str, Any]:
        statistics = self.statistics
        height, width = (side * self.tiled_map.resolution_m for side in self.tiled_map.shape)
        return {
            "particles": self.configuration.particles,
            "particles_mean": statistics.particles_mean,
            "resamplings": statistics.resamplings,
            "n_eff_mean": statistics.n_eff_mean,
            "n_eff_min": statistics.n_eff_min,
            "map_width_m": width,
            "map_height_m": height,
            "maps_bytes": self.maps_bytes,
        }

    def _describe_loop_closure(self, loops: LoopClosureSummary) -> dict[str, Any]:
        return {
            "closures": [
                {"key_scans": pair, "stamps_ns": self.key_stamps_ns[pair].tolist()} for pair in loops.closures.tolist()
            ],
            "removed": loops.removed,
            "rejected": {reason.value: loops.rejected[reason] for reason in RejectionReason if loops.rejected[reason]},
            "unsearched": loops.unsearched,
            "corrections": self.statistics.corrections,
            "constraints": {source.name.lower(): loops.constraints[source] for source in ConstraintSource},
            "refinement_constraints": loops.refinement_constraints,
            "chi2": loops.chi2,
            "max_correction_m": loops.max_correction_m,
            "candidates": {  # the agreement is null if no beam was compared
                name: asdict(score) | {"agreement": score.agreement if score.beams else None}
                for name, score in loops.candidates.items()
            },
            "selected": loops.selected,
            "sharpness_m": loops.sharpness_m,
        }


@checked
def map_log(
    log: LogSource,
    *,
    preset: str = "default",
    particles: int | None = None,
    laser: str | None = None,
    configuration: Configuration | None = None,
    seed: int = 0,
    threads: int = 1,
    options: LogOptions | None = None,
    repair: Literal["needed", "none"] = "needed",
    observers: Sequence[Observer] = (),
    gate: Callable[[Iterable[Measurement]], Iterable[Measurement]] = iter,
    on_progress: Callable[[], None] = lambda: None,
    stopwatch: Stopwatch | None = None,
    keep_particles: bool = True,
    digest: str | None = None,
    beginning: Beginning | None = None,
    on_finding: Callable[[Finding], None] = lambda finding: None,
    **parts: Any,  # noqa: ANN401
) -> MapResult:
    """Map a log with grid-based FastSLAM and loop closure.

    A scan at which the filter raises an exception is skipped, and the result reports it (see `MapResult.failures`).
    Where the robot was carried a new piece of the map begins, and the robot is looked for in what was mapped before.

    Parameters
    ----------
    log : str, Path or Log
        The log, of any format that `open_log` knows.
    preset : str
        "default" or "gmapping".
    particles : int, optional
        Number of particles; the preset's own if not given.
    laser : str, optional
        What the laser is, a name of `gridslam.config.LASERS`: limits and cells that suit it, over the preset.
    configuration : Configuration, optional
        Instead of a preset, a number of particles and a laser. The filter alone is `Configuration(loop_closure=None)`.
    seed : int, >= 0
        The same log, configuration and seed give identical results.
    threads : int, >= 1
        Threads of the kernels; their number never changes a result.
    options : LogOptions, optional
        What to read of the log at a path.
    repair : "needed" or "none"
        Faults of the log corrected before mapping: those that make any map unusable (a mirrored or misaligned laser),
        or none. The result reports them.
    observers : sequence of Observer
        Called after each scan.
    gate : callable
        Gets the measurements on their way to the filter and gives them on, as they are, when they may go.
    on_progress : callable
        Called after each scan, and periodically during the final refinement.
    stopwatch : Stopwatch, optional
        A stopwatch to continue.
    keep_particles : bool
        False: after the last scan the best particle alone is kept, so that the final refinement can use the memory of
        the others' maps, and in the end no scan. The map and its trajectory are the same; no session can be saved.
    digest : str, optional
        SHA-256 of the log, where it is known (see `gridslam.io.text.compute_digest`).
    beginning : Beginning, optional
        The session that the run continues (see `Session.add`).
    on_finding : callable
        Called where the robot was carried (`robot_carried`).
    **parts
        Parts of the filter, of one's own, instead of those of the configuration: `tracker`, `motion`, `sensor`,
        `proposal`, `resampler`, `when_to_update`, `when_to_resample` (see `GridFastSlam`). `run.json` names their
        classes; a session that is saved does not hold them, and continues with the configuration's.

    Raises
    ------
    ArgumentError
        The seed is negative, there is no thread, `configuration` and one of `particles` and `laser` are given,
        both `options` and a log that is open already, or a part has another name.
    InputError
        The log cannot be read.
    ConfigurationError
        There is no such preset or laser, or the number of particles is out of range.
    """
    require_seed(seed)
    require_threads(threads)
    require_instance("configuration", configuration, Configuration, optional=True)
    if configuration is None:
        configuration = preset_of(preset, particles)
        configuration = configuration if laser is None else apply_laser(configuration, laser)
    elif particles is not None or laser is not None:
        got = particles if laser is None else laser
        raise ArgumentError("particles, laser", "none where a configuration is given", got)
    watch = stopwatch or Stopwatch()
    source = open_repaired(log, options, repair)
    begun = beginning or Beginning(SavedRun(np.random.default_rng(seed), name=source.path.name.partition(".")[0]))
    slam = replace(build(configuration, threads), **_require_own(parts))
    digest = digest or compute_digest(source.path)
    watch.lap("start")

    def drive(measurements: Iterable[Measurement], begun: Beginning) -> Beginning:
        so_far = begun.run
        state = run(
            gate(measurements),
            slam,
            rng=so_far.rng,
            observers=[begun.attach, so_far.trajectory, so_far.statistics, *observers, lambda *_: on_progress()],
            state=begun.attach_to(so_far.state),
            stopwatch=watch,
            on_failure=begun.failures,
        )
        begun.finish(state, slam)
        watch.lap("finish")
        driven = DrivenLog.of(os.fspath(source.path), digest, source.statistics)
        return begun.go_on(state, _describe_part(begun, driven))

    carried: dict[str, str] = {}

    def note_break(finding: Finding) -> None:
        carried[finding.title] = finding.message
        on_finding(finding)

    drives = split_where_carried(source, note_break)
    if configuration.loop_closure is None:  # no drive can be relocalized
        drives = iter([chain.from_iterable(drives)])
    ended = drive(next(drives, iter(())), begun)
    for measurements in drives:
        begun = begin_new_piece(ended, configuration, seed, on_progress)
        watch.lap("final refinement")
        ended = drive(measurements, begun)
    statistics = source.statistics
    statistics.faults.update(carried)
    result = finish_mapping(
        ended.run,
        configuration,
        seed=seed,
        threads=threads,
        log=statistics,
        source=source.path,
        digest=digest,
        repair=find_repair(source),
        on_progress=on_progress,
        stopwatch=watch,
        keep_particles=keep_particles,
        failures=ended.failures.describe(),
        pieces=ended.pieces,
    )
    result = replace(result, own_parts={name: type(part).__name__ for name, part in parts.items()})
    watch.lap("finish")
    return result


def _require_own(parts: dict[str, Any]) -> dict[str, Any]:
    """Return parts of the filter by their names; raises ArgumentError for another name, and for values of no use."""
    for name, part in parts.items():
        if name not in _OWN_PARTS:
            raise ArgumentError(name, f"an argument of map_log, or a part: {', '.join(_OWN_PARTS)}", part)
        if not callable(getattr(part, "step", part)):
            raise ArgumentError(name, "a part of the filter, which can be called", part)
    return parts


def _describe_part(begun: Beginning, log: DrivenLog) -> DrivenLog:
    """Describe a drive's part of a log so far: all of it, unless the robot was carried."""
    before = sum(driven.scans for driven in begun.run.logs)
    stamps_ns = begun.run.trajectory.online_trajectory().stamps_ns[before:].tolist()
    if len(stamps_ns) + begun.failures.count >= log.scans or not stamps_ns:
        return log
    drives = [*begun.run.earlier, *(drive for piece in begun.pieces for drive in piece.drives)]
    others = [own for drive in drives for own in drive.logs if own.sha256 == log.sha256]
    length_m = max(log.length_m - sum(own.length_m for own in others), 0.0)
    return DrivenLog(log.path, log.sha256, len(stamps_ns), stamps_ns[0], stamps_ns[-1], length_m)


def finish_mapping(
    run: SavedRun,
    configuration: Configuration,
    *,
    seed: int,
    threads: int,
    log: LogStatistics,
    source: Path,
    digest: str,
    repair: Repair,
    on_progress: Callable[[], None] = lambda: None,
    stopwatch: Stopwatch,
    keep_particles: bool = True,
    failures: tuple[str, ...] = (),
    pieces: tuple[SavedPiece, ...] = (),
) -> MapResult:
    """Refine the trajectory after the last scan, and build the result of a run; the arguments are `MapResult`'s.

    Where the final refinement raises an exception the trajectory is that of the best particle.
    """
    state = run.state
    assert state is not None
    maps_bytes = state.maps.nbytes
    if not keep_particles:
        state.keep_best()
    drives = run.drives
    refine = partial(
        full_slam,
        drives=[drive.scans for drive in drives],
        mapper=configuration.mapper,
        loop_closure=configuration.loop_closure,
        on_progress=on_progress,
    )
    try:
        full = refine(state)
    except Exception as error:
        if state.closure_state is None:
            raise
        problem = f"the final refinement failed: {describe_error(error)}; the trajectory is that of the best particle"
        failures = (*failures, problem)
        full = refine(replace(state, closure_state=None))
    found_again = None if state.closure_state is None else _describe_joined(state.closure_state, drives)
    if not keep_particles:
        state.closure_state = None
    stopwatch.lap("final refinement")
    key_stamps_ns = np.zeros(state.ancestry.steps, np.int64)
    for drive in drives:
        key_stamps_ns[np.unique(drive.scans.keys)] = drive.key_stamps_ns
    stamps_ns = np.concatenate([drive.stamps_ns for drive in drives])
    order = _sort_scans(drives) if len(drives) > 1 else np.arange(len(stamps_ns))
    return MapResult(
        trajectory=Trajectory(stamps_ns[order], full.poses[order]),
        covariances=full.covariances[order],
        online_trajectory=run.trajectory.online_trajectory(),
        tiled_map=full.tiled_map,
        graph=full.graph,
        loop_summary=full.loop_summary,
        key_stamps_ns=key_stamps_ns,
        state=state,
        maps_bytes=maps_bytes,
        statistics=run.statistics.summary(),
        log=log,
        configuration=configuration,
        seed=seed,
        threads=threads,
        source=source,
        digest=digest,
        repair=repair,
        stopwatch=stopwatch,
        failures=failures,
        map_piece=SavedPiece(full.piece, drives) if full.piece is not None and keep_particles else None,
        drives=() if full.piece is None else drives,
        run=run if keep_particles else None,
        pieces=pieces,
        found_again=found_again,
    )


def _describe_joined(closure_state: LoopClosureState, drives: Sequence[Drive]) -> FoundAgain | None:
    """Describe where the newest drive was joined with the earlier ones; None if it was not."""
    if closure_state.joined < 0:
        return None
    *earlier, newest = drives
    stamp_ns = int(newest.key_stamps_ns[closure_state.joined_after - 1])
    way_m = closure_state.driven_before_found_m(int(newest.scans.keys[0]))
    return FoundAgain(tuple(drive.name for drive in earlier), stamp_ns, way_m)


def _sort_scans(drives: Sequence[Drive]) -> IntArray:
    """Return indices (N,) that sort the scans of all drives, concatenated drive by drive, by their stamps."""
    return np.argsort(np.concatenate([drive.stamps_ns for drive in drives]), kind="stable")


def _describe_odometry_errors(state: TrackerState) -> dict[str, Any]:
    """Estimated odometry errors: ratios of true to measured increments, and the residual per segment."""
    errors = state.odometry_errors
    a, c, _, _, turn_scale, turn_rad_per_m = errors.factors.tolist()
    sigma_m, sigma_rad = np.sqrt(errors.variances).tolist()
    return {
        "trusted": errors.trusted,
        "segments": errors.segments,
        "scale": math.hypot(a, c),
        "direction_rad": math.atan2(c, a),
        "turn_scale": turn_scale,
        "turn_rad_per_m": turn_rad_per_m,
        "sigma_m": sigma_m,
        "sigma_rad": sigma_rad,
    }
