"""run.json: what was read and done, how long it took, and with which parameters."""

from __future__ import annotations

import math
import os
import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gridslam import __version__
from gridslam.config.tables import to_table
from gridslam.io.log_statistics import LogStatistics
from gridslam.kernels import compiled
from gridslam.observers import RunStatistics
from gridslam.slam.full_slam.full_slam import LoopClosureSummary
from gridslam.slam.full_slam.trajectory_score import TrajectoryScore
from gridslam.slam.loop_closure.constraints import ConstraintSource
from gridslam.slam.loop_closure.state import RejectionReason
from gridslam.slam.tracking.tracker import Tracker, TrackerState
from gridslam.types import IntArray

if TYPE_CHECKING:
    from gridslam.api.result import MapResult
    from gridslam.doctor.repair import Repair

__all__ = ["RUN_SCHEMA", "run_document"]

RUN_SCHEMA = "gridslam.run/3"
_ORDERS = {1: "as told", 0: "none", -1: "backward"}


def run_document(result: MapResult) -> dict[str, Any]:
    """Build the content of run.json."""
    statistics = result.statistics
    return {
        "schema": RUN_SCHEMA,
        "version": __version__,
        "seed": result.seed,
        "threads": result.threads,
        "kernels": "compiled" if compiled else "reference",
        "input": _input(result.source, result.digest, result.log, result.repair),
        "scans": _scans(statistics, result.log),
        "tracker": _tracker(result),
        "filter": _filter(result),
        "loop_closure": result.loop_summary is not None
        and _loop_closure(result.loop_summary, result.key_stamps_ns, statistics.corrections),
        "time": result.stopwatch.to_dict(),
        "latency": {"key_scans": asdict(statistics.key_latency), "all_scans": asdict(statistics.latency)},
        "peak_memory_bytes": _peak_memory_bytes(),
        "configuration": to_table(result.configuration),
    }


def _input(source: Path, digest: str, log: LogStatistics, repair: Repair) -> dict[str, Any]:
    return {
        "path": os.fspath(source),
        "sha256": digest,
        "bytes": log.total_bytes,
        "truncated": log.truncated,
        "selection": log.selection,
        "duration_s": log.duration_s,
        "sensors": {sensor: _sensor(sensor, log) for sensor in log.mountings},
        "odometry": log.odometry_source,
        "without_odometry": log.without_odometry,
        "odometry_length_m": log.odometry_length_m,
        "backward_stamps": log.backward_stamps,
        "duplicate_stamps": log.duplicate_stamps,
        "invalid_beams": log.invalid_beams,
        "no_return_beams": log.no_return_beams,
        "missing_transforms": dict(log.missing_transforms),
        "remarks": dict(log.remarks),
        "repair": asdict(repair) if repair else None,
    }


def _sensor(sensor: str, log: LogStatistics) -> dict[str, Any]:
    """Pose of a laser in the base frame, and the number of scans at which it had changed since the first."""
    mounting = log.mountings[sensor]
    moved = log.moving_mountings[sensor]
    return {"base_from_laser": mounting.pose.tolist(), "source": mounting.source, "moved": moved}


def _scans(statistics: RunStatistics, log: LogStatistics) -> dict[str, Any]:
    return {
        "read": log.scan_count,
        "used": statistics.key_scans,
        "skipped": {reason.value: count for reason, count in statistics.skipped.items()},
        "lost": statistics.lost,
        "degenerate": statistics.degenerate,
    }


def _tracker(result: MapResult) -> dict[str, Any] | None:
    """Summary of the tracker; None for the tracker that uses the odometry unchanged."""
    tracker, state = result.configuration.tracker, result.state.tracker
    if not isinstance(tracker, Tracker):
        return None
    timed = {sensor: track for sensor, track in state.sensors.items() if track.beam_order.scans}
    return {
        "odometry": _learned(state) if result.log.without_odometry < result.log.scan_count else None,
        "odometry_rejected": state.rejected_odometry,
        "stamps_reliable": not state.stamps_unreliable,
        "beam_order": {sensor: _ORDERS[track.best_order] for sensor, track in timed.items()},
    }


def _learned(state: TrackerState) -> dict[str, Any]:
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


def _filter(result: MapResult) -> dict[str, Any]:
    statistics, grid = result.statistics, result.tiled_map
    height, width = (side * grid.resolution_m for side in grid.shape)
    return {
        "particles": result.configuration.particles,
        "resamplings": statistics.resamplings,
        "n_eff_mean": statistics.n_eff_mean,
        "n_eff_min": statistics.n_eff_min,
        "map_width_m": width,
        "map_height_m": height,
        "maps_bytes": result.maps_bytes,
    }


def _loop_closure(loops: LoopClosureSummary, key_stamps_ns: IntArray, corrections: int) -> dict[str, Any]:
    return {
        "closures": [
            {"key_scans": pair, "stamps_ns": key_stamps_ns[pair].tolist()} for pair in loops.closures.tolist()
        ],
        "removed": loops.removed,
        "rejected": {reason.value: loops.rejected[reason] for reason in RejectionReason if loops.rejected[reason]},
        "corrections": corrections,
        "constraints": {source.name.lower(): loops.constraints[source] for source in ConstraintSource},
        "refinement_constraints": loops.refinement_constraints,
        "chi2": loops.chi2,
        "max_correction_m": loops.max_correction_m,
        "candidates": {name: _score(score) for name, score in loops.candidates.items()},
        "selected": loops.selected,
    }


def _score(score: TrajectoryScore) -> dict[str, Any]:
    """Score of a candidate; the agreement is null if no beam was compared."""
    return asdict(score) | {"agreement": score.agreement if score.beams else None}


def _peak_memory_bytes() -> int:
    """Greatest memory that this process has held.

    `getrusage` may report the memory of the parent process, so /proc is read first.
    """
    try:
        lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
        return next(1024 * int(line.split()[1]) for line in lines if line.startswith("VmHWM:"))
    except (OSError, StopIteration, ValueError):
        import resource  # where there is no /proc

        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return peak if sys.platform == "darwin" else 1024 * peak
