"""Times of the kernels against their NumPy twins, on calls recorded while the filter maps a simulated building.

python benchmarks/kernels.py [--particles 30] [--scans 400] [--repeats 20]
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, NamedTuple, final

import numpy as np

import gridslam.grid.tiles as tiles
from gridslam import GridFastSlam, build, preset
from gridslam.kernels import backend, compiled, reference
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, SimulatedLog, make_world, simulate
from gridslam.types import Beams, FloatArray
from report import table

__all__ = ["Situation", "kernel_times", "record"]


class _Call(NamedTuple):
    """Arguments of a kernel, as they were before it ran, and what it returned."""

    arguments: tuple[Any, ...]
    result: Any


@final
class _Recorder:
    """Stands in for the kernels and keeps the last call of each."""

    def __init__(self) -> None:
        self.calls: dict[str, _Call] = {}

    def __getattr__(self, name: str) -> Callable[..., Any]:
        def call(*arguments: Any) -> Any:  # noqa: ANN401
            before = _copied(arguments)
            result = getattr(backend, name)(*arguments)
            self.calls[name] = _Call(before, result)
            return result

        return call


def _copied(arguments: tuple[Any, ...]) -> tuple[Any, ...]:
    return tuple(value.copy() if isinstance(value, np.ndarray) else value for value in arguments)


@contextmanager
def _recording() -> Iterator[_Recorder]:
    recorder = _Recorder()
    tiles.backend = recorder
    try:
        yield recorder
    finally:
        tiles.backend = backend


@final
@dataclass(frozen=True)
class Situation:
    """Calls of the kernels at one key scan, and how much work each had: a count and what was counted."""

    calls: dict[str, _Call]
    work: dict[str, tuple[int, str]]
    particles: int
    beams: int


def record(particles: int = 30, scans: int = 400) -> Situation:
    """Map the first scans of the demo's building, then record the first key scan after a resampling."""
    rng = np.random.default_rng(0)
    world = make_world("demo", rng)
    log = simulate(world, RobotConfig(), OdometryNoise(), LidarConfig(), rng)
    slam = build(preset("default", particles))
    return _after_resampling(log, slam, particles, scans, rng)


def _after_resampling(
    log: SimulatedLog, slam: GridFastSlam, particles: int, scans: int, rng: np.random.Generator
) -> Situation:
    """Every particle's map is shared then, so that the tiles which a scan touches are copied: the most costly case."""
    state, _ = slam.init(*log.measurements[0], particles)
    for count, (odometry, scan) in enumerate(log.measurements[1:], 1):
        if count < scans:
            state, _ = slam.step(state, odometry, scan, rng)
            continue
        if count == scans:
            state.resample(np.sort(rng.integers(0, particles, particles)))
        with _recording() as recorder:
            state, report = slam.step(state, odometry, scan, rng)
            if report.skipped is None:
                beams = scan.beams(slam.range_min_m, slam.range_max_m)
                rows = np.arange(particles, dtype=np.int32)
                state.maps.cast_rays(rows, state.poses, beams.origin, scan.geometry.directions, slam.range_max_m)
                state.maps.distances(rows, state.poses, beams.ends)
                work = _work(recorder.calls, state.poses, beams, state.maps.resolution_m)
                return Situation(recorder.calls, work, particles, len(beams))
    raise ValueError(f"no key scan after scan {scans} of {len(log)}")


def _work(
    calls: dict[str, _Call], poses: FloatArray, beams: Beams, resolution_m: float
) -> dict[str, tuple[int, str]]:
    rays = beams.ends - beams.origin
    reach, bearing = np.hypot(*rays.T), np.arctan2(rays[:, 1], rays[:, 0])
    angles = poses[:, 2:] + bearing
    cells = reach * np.maximum(np.abs(np.cos(angles)), np.abs(np.sin(angles))) / resolution_m
    looked_up = len(poses) * len(beams)
    touched, changed = len(calls["touch_rays"].result), len(calls["update_log_odds"].result)
    return {
        "match": (looked_up, "beam"),
        "distances": (looked_up, "beam"),
        "cast_rays": (calls["cast_rays"].result.size, "beam"),
        "touch_rays": (touched, "tile"),
        "own": (len(calls["own"].arguments[-1]), "tile"),
        "update_log_odds": (round(float(cells.sum())), "cell on a ray"),
        "touch_cells": (changed, "changed cell"),
        "update_field": (changed, "changed cell"),
    }


def median_s(kernel: Callable[..., Any], call: _Call, repeats: int) -> float:
    """Median wall seconds of a call; its arguments are copied anew each time, for kernels write into them."""
    seconds = []
    for _ in range(repeats):
        arguments = _copied(call.arguments)
        begin = time.perf_counter()
        kernel(*arguments)
        seconds.append(time.perf_counter() - begin)
    return statistics.median(seconds)


def kernel_times(situation: Situation, repeats: int = 20) -> str:
    """Table of the kernels; a twin is repeated as often as it fits, for it takes long."""
    rows = []
    for name, (count, what) in situation.work.items():
        call = situation.calls[name]
        ours = median_s(getattr(backend, name), call, repeats)
        twin = median_s(getattr(reference, name), call, max(1, repeats // 7))
        each_ns = 1e9 * ours / max(1, count)
        rows.append([name, 1e6 * ours / situation.particles, each_ns, what, count, 1e3 * twin, twin / ours])
    head = ["kernel", "us per particle", "ns each", "of", "how many", "NumPy twin ms", "times slower"]
    return table(head, rows)


def main() -> None:
    parser = argparse.ArgumentParser(description="Times of the kernels against their NumPy twins.")
    parser.add_argument("--particles", type=int, default=30)
    parser.add_argument("--scans", type=int, default=400, help="scans mapped before a key scan is recorded")
    parser.add_argument("--repeats", type=int, default=20)
    given = parser.parse_args()
    situation = record(given.particles, given.scans)
    if not compiled:
        print("The kernels are not compiled: the twins are compared with themselves.")
    print(f"{situation.particles} particles, {situation.beams} beams, one thread, median of {given.repeats}\n")
    print(kernel_times(situation, given.repeats))


if __name__ == "__main__":
    main()
