"""Times of the kernels against their NumPy twins, on calls recorded while the filter maps a simulated building.

python benchmarks/kernels.py [--particles 30] [--scans 400] [--repeats 20]
"""

from __future__ import annotations

import argparse
import inspect
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, final
from unittest.mock import patch

import numpy as np

from gridslam import StepReport, build, preset, run
from gridslam.kernels import backend, compiled, reference
from gridslam.localization.known_map import FieldTable
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.matching import BranchAndBound, Pyramid
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate
from gridslam.types import Beams, FloatArray
from report import table

__all__ = ["ELSEWHERE", "Call", "Situation", "fork_join_us", "kernel_times", "record"]

ELSEWHERE = {
    *("begin_update", "end_update", "draw_scans", "known_cells", "match_scans", "select_beams", "shortest_ways"),
    *("parse_numbers", "format_rows", "hamming_distances", "fit_surfaces", "match_surfaces", "match_to_surfaces"),
    *("draw_gaussians", "kalman_update", "predict_landmarks", "are_true", "mean_shift", "slots_of"),
}
"""Kernels that no particle's map needs in one thread: of many scans in one map, reading, places, landmarks, beliefs."""

_SEARCH = "gridslam.matching.branch_and_bound.backend"
_TABLE = "gridslam.localization.known_map.backend"


class Call(NamedTuple):
    """Arguments of a kernel, as they were before it ran, and what it returned."""

    arguments: tuple[Any, ...]
    result: Any


@final
class _Recorder:
    """Stands in for the kernels and keeps the last call of each."""

    def __init__(self) -> None:
        self.calls: dict[str, Call] = {}

    def __getattr__(self, name: str) -> Callable[..., Any]:
        def call(*arguments: Any) -> Any:  # noqa: ANN401
            before = _copied(arguments)
            result = getattr(backend, name)(*arguments)
            self.calls[name] = Call(before, result)
            return result

        return call


def _copied(arguments: tuple[Any, ...]) -> tuple[Any, ...]:
    return tuple(value.copy() if isinstance(value, np.ndarray) else value for value in arguments)


@final
@dataclass(frozen=True)
class Situation:
    """Calls of the kernels at one key scan, and how much work each had: a count and what was counted."""

    calls: dict[str, Call]
    work: dict[str, tuple[int, str]]
    particles: int
    beams: int


def record(particles: int = 30, scans: int = 400) -> Situation:
    """Map the first scans of the demo's building, resample, and record the next key scan.

    Every particle's map is shared then, so that the tiles which a scan touches are copied: the most costly case.
    """
    rng = np.random.default_rng(0)
    log = simulate(make_world("demo", rng), RobotConfig(), OdometryNoise(), LidarConfig(), rng)
    slam = build(preset("default", particles))
    state = run(log.measurements[:scans], slam, particles=particles, rng=rng)
    state.resample(np.sort(rng.integers(0, particles, particles)))
    reports: list[StepReport] = []
    for measurement in log.measurements[scans:]:
        recorder = _Recorder()
        with patch("gridslam.grid.tiles.backend", recorder), patch(_SEARCH, recorder), patch(_TABLE, recorder):
            observers = [lambda report, state, seconds: reports.append(report)]
            state = run([measurement], slam, rng=rng, state=state, observers=observers)
            if reports[-1].skipped is None:
                beams, rows = measurement.scan.beams(slam.range_min_m, slam.range_max_m), np.arange(particles)
                directions = measurement.scan.geometry.directions
                state.maps.cast_rays(rows, state.poses, beams.origin, directions, slam.range_max_m)
                state.maps.distances(rows, state.poses, beams.ends)
                BranchAndBound(window_m=3.0, window_rad=0.3).search(
                    Pyramid.of(state.maps, 0), state.poses[0], None, beams.ends
                )
                crossed = recorder.tiles_on_rays(
                    rows.astype(np.int32), state.poses, beams.ends, beams.origin, state.maps.resolution_m, 1
                )
                state.maps._arena.reserve(100, len(crossed))
                state.maps.snapshot()._make_writable(crossed)
                field = rng.random((400, 400), np.float32)
                FieldTable.of(field, np.full(2, -10.0), state.maps.resolution_m).sums(state.poses, beams.ends, 1)
                work = _work(recorder.calls, state.poses, beams, state.maps.resolution_m)
                return Situation(recorder.calls, work, particles, len(beams))
    raise ValueError(f"no key scan after scan {scans} of {len(log)}")


def _work(calls: dict[str, Call], poses: FloatArray, beams: Beams, resolution_m: float) -> dict[str, tuple[int, str]]:
    rays = beams.ends - beams.origin
    reach, bearing = np.hypot(*rays.T), np.arctan2(rays[:, 1], rays[:, 0])
    angles = poses[:, 2:] + bearing
    cells = reach * np.maximum(np.abs(np.cos(angles)), np.abs(np.sin(angles))) / resolution_m
    looked_up = len(poses) * len(beams)
    searched = inspect.signature(reference.correlate).bind(*calls["correlate"].arguments).arguments
    x0, x1, y0, y1 = searched["window"]
    return {
        "match": (looked_up, "beam"),
        "match_pose": (len(beams), "beam"),
        "distances": (looked_up, "beam"),
        "sum_at_ends": (looked_up, "beam"),
        "cast_rays": (calls["cast_rays"].result.size, "beam"),
        "tiles_on_rays": (len(calls["tiles_on_rays"].result), "tile"),
        "make_tiles_writable": (len(calls["make_tiles_writable"].arguments[-1]), "tile"),
        "update": (round(float(cells.sum())), "cell on a ray"),
        "max_pyramid": (calls["max_pyramid"].result[0].size, "cell"),
        "correlate": ((x1 - x0) * (y1 - y0) * len(searched["headings"]), "pose of the lattice"),
    }


def median_s(kernel: Callable[..., Any], call: Call, repeats: int) -> float:
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


def fork_join_us(threads: int, repeats: int = 20_000) -> float:
    """Mean time in us that `threads` take longer than one thread where there is nothing to do for them."""
    maps = OccupancyGridMapping().empty(threads)
    rows, poses, ends = np.arange(threads), np.zeros((threads, 3)), np.ones((1, 2))
    seconds = []
    for maps.threads in (1, threads):
        begin = time.perf_counter()
        for _ in range(repeats):
            maps.distances(rows, poses, ends)
        seconds.append(time.perf_counter() - begin)
    return 1e6 * (seconds[1] - seconds[0]) / repeats


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
    for threads in (2, 4):
        print(f"{threads} threads begin and end together: {fork_join_us(threads):.1f} us")


if __name__ == "__main__":
    main()
