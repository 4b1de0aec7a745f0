"""How cost grows: with particles, with the size of the map, with threads, with beams."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gridslam import MapResult, map_log
from gridslam.types import FloatArray
from logs import Log, ring, simulated
from measure import MapRun, map_timed, yardstick_s
from report import Report, Target, table

__all__ = ["beams", "map_size", "particles", "threads"]

_LAST = 300
"""Scans at the end of a drive that tell what a scan costs in a large map: some 70 m."""

_FLAT = 1.2
"""Cost of a scan in the largest map over that in the smallest, up to which it counts as flat."""


def particles(log: Log, counts: Sequence[int], report: Report) -> None:
    """Map a log with ever more particles."""
    rows: list[list[object]] = []
    for count in counts:
        run = map_timed(log.path, "--particles", count)
        each_us = 1e6 * _stage_s(run, "step") / run.document["scans"]["used"] / count
        latency = run.latency_ms
        maps_mb = run.document["filter"]["maps_bytes"] / 1e6
        cost = [run.cost.cpu_s, run.cost.yardsticks, each_us, run.peak_mb, maps_mb]
        rows.append([count, *cost, latency["median"], latency["p99"], latency["max"]])
        if log.name == "intel" and count == 1000:
            report.targets += [
                Target("intel, 1000 particles: CPU", run.cost.yardsticks, 1000.0, unit="yardsticks"),
                Target("intel, 1000 particles: peak memory", run.peak_mb, 1500.0, unit="MB"),
            ]
    head = ["particles", "CPU s", "yardsticks", "us per particle and key scan", "peak MB", "maps MB"]
    report.add(f"Particles: {log.name}", table([*head, "scan ms (median)", "p99", "longest"], rows))


def map_size(sides_m: Sequence[float], folder: Path, report: Report) -> None:
    """Map a corridor around buildings of growing size; what is seen at a time stays alike."""
    rows: list[list[object]] = []
    costs: list[float] = []
    for side in sides_m:
        log = simulated(ring(side, np.random.default_rng(0)), folder, v_max_m_s=1.2)
        before = yardstick_s()
        result, cpu_s = _mapped_here(log)
        last = cpu_s[-_LAST:]
        costs.append(2 * float(last.mean()) / (before + yardstick_s()))
        maps_mb, resamplings = result.state.maps.nbytes / 1e6, result.statistics.resamplings
        milliseconds = 1e3 * float(last.mean()), 1e3 * float(last.max())
        rows.append([f"{side:g} m", len(result.trajectory), *milliseconds, 1e3 * costs[-1], maps_mb, resamplings])
    report.targets.append(Target(f"cost of a scan, {rows[-1][0]} over {rows[0][0]} map", costs[-1] / costs[0], _FLAT))
    head = ["side", "scans", "CPU ms a scan (mean)", "longest", "1/1000 yardsticks", "maps MB", "resamplings"]
    note = f"Of the last {_LAST} scans of a drive along three sides of the building."
    report.add("Size of the map", table(head, rows), note)


def threads(log: Log, counts: Sequence[int], report: Report, count: int = 100) -> None:
    """Map a log with several threads: wall time falls, the trajectory stays."""
    rows: list[list[object]] = []
    first: MapRun | None = None
    for number in counts:
        run = map_timed(log.path, "--particles", count, "--threads", number)
        first = first or run
        same = "yes" if np.array_equal(first.trajectory.poses, run.trajectory.poses) else "**NO**"
        step = run.document["time"]["stages"]["step"]["wall_s"]
        faster = first.document["time"]["stages"]["step"]["wall_s"] / step
        rows.append([number, run.cost.wall_s, run.cost.cpu_s, step, faster, run.latency_ms["p99"], same])
    head = ["threads", "wall s", "CPU s", "key scans: wall s", "times faster", "scan ms (p99)", "same trajectory"]
    report.add(f"Threads: {log.name}, {count} particles", table(head, rows))


def beams(counts: Sequence[int], folder: Path, report: Report, scans: int | None = None) -> None:
    """Map the demo's building, seen by lidars of ever more beams over 270 degrees."""
    rows: list[list[object]] = []
    for count in counts:
        run = map_timed(simulated("demo", folder, beams=count, fov_deg=270.0, scans=scans).path)
        used, read = run.document["scans"]["used"], run.document["scans"]["read"]
        key_ms, track_ms = 1e3 * _stage_s(run, "step") / used, 1e3 * _stage_s(run, "track") / (read - used)
        latency = run.latency_ms["p99"]
        rows.append([count, run.cost.cpu_s, run.cost.yardsticks, key_ms, 1e3 * key_ms / count, track_ms, latency])
    head = ["beams", "CPU s", "yardsticks", "key scan ms", "us per beam", "other scan ms", "scan ms (p99)"]
    report.add("Beams: demo (simulated)", table(head, rows))


def _mapped_here(log: Log) -> tuple[MapResult, FloatArray]:
    """Map a log in this process; returns the CPU seconds of each scan, too."""
    clock = [time.process_time()]
    result = map_log(log.path, observers=[lambda report, state, seconds: clock.append(time.process_time())])
    return result, np.diff(clock)


def _stage_s(run: MapRun, stage: str) -> float:
    """CPU seconds of a stage."""
    return float(run.document["time"]["stages"][stage]["cpu_s"])
