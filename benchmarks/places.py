"""The search for places: what it costs by window, in maps that hold the place and in maps that do not.

python benchmarks/places.py [--queries 40]
"""

from __future__ import annotations

import argparse
import math
import statistics
import time
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from gridslam.mapping import OccupancyGridMapping
from gridslam.matching import BranchAndBound, LatticeMatch, Pyramid
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate
from gridslam.types import FloatArray
from report import Report, Target, table

__all__ = ["Place", "place_search"]

_RANGE_M = 30.0


class Place(NamedTuple):
    """A scan's true pose (3,) in a map, and its points (B, 2)."""

    pose: FloatArray
    points: FloatArray


class _Window(NamedTuple):
    name: str
    search: BranchAndBound
    covariance: FloatArray | None = None


_TURN = np.array([[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
_WINDOWS = (
    _Window("8 m, 0.3 rad", BranchAndBound(window_m=8.0, window_rad=0.3)),
    _Window("15 m, 0.5 rad", BranchAndBound(window_m=15.0, window_rad=0.5)),
    _Window("15 m, full turn", BranchAndBound(window_m=15.0, window_rad=math.pi)),
    _Window("gate 5 m x 0.5 m, 0.3 rad", BranchAndBound(), _TURN @ np.diag([5 / 3, 0.5 / 3, 0.1]) ** 2 @ _TURN.T),
)


def place_search(report: Report, worlds: Sequence[str] = ("demo", "rooms", "loop"), queries: int = 20) -> None:
    """Search scans in the map of their own world and in that of the next, from guesses all over the window.

    `queries` scans of each of `worlds`, seen anywhere on the drive that mapped it.
    """
    rng = np.random.default_rng(0)
    mapped = [_mapped(world, queries, rng) for world in worlds]
    sizes = [_cells(pyramid) for pyramid, _, _ in mapped]
    rows: list[list[object]] = []
    medians: list[float] = []
    for window in _WINDOWS:
        for name, shift in (("in its own map", 0), ("in another map", 1)):
            times, right, ambiguous = [], 0, 0
            for k, (_, places, _) in enumerate(mapped):
                pyramid = mapped[(k + shift) % len(mapped)][0]
                for place in places:
                    begin = time.perf_counter()
                    found = _searched(window, pyramid, place, rng)
                    times.append(1e3 * (time.perf_counter() - begin))
                    right += found is not None and math.hypot(*(found.pose - place.pose)[:2]) < 0.15
                    ambiguous += found is not None and found.runner_up_score > 0.85 * found.score
            told = [right, ambiguous] if shift == 0 else ["", ambiguous]
            medians.append(statistics.median(times))
            rows.append([window.name, name, medians[-1], max(times), len(times), *told])
    pyramid_ms = max(best for _, _, best in mapped)
    report.targets += [
        Target("pyramid of the largest map searched", pyramid_ms, 3.0, unit="ms"),
        Target("search within 8 m and 0.3 rad, median", medians[0], 10.0, unit="ms"),
    ]
    head = ["window", "scan", "ms (median)", "longest", "searches", "found within 0.15 m", "another place above 0.85"]
    note = f"Maps of {', '.join(sizes)} cells; the slowest pyramid took {pyramid_ms:.3g} ms. One thread."
    report.add("Search for places", note, table(head, rows))


def _mapped(world: str, queries: int, rng: np.random.Generator) -> tuple[Pyramid, list[Place], float]:
    """Pyramid of a world's map, places in it, and the milliseconds that the pyramid takes."""
    log = simulate(make_world(world, rng), RobotConfig(), OdometryNoise(), LidarConfig(), rng)
    maps, row = OccupancyGridMapping().empty(1), np.zeros(1, np.int32)
    seen = [measurement.scan.beams(0.05, _RANGE_M) for measurement in log.measurements]
    for i in range(0, len(log), 10):
        maps.update(row, log.truth.poses[i : i + 1], seen[i])
    chosen = np.sort(rng.choice(len(log), queries, replace=False))
    times = []
    for _ in range(5):
        begin = time.perf_counter()
        pyramid = Pyramid.of(maps, 0)
        times.append(1e3 * (time.perf_counter() - begin))
    return pyramid, [Place(log.truth.poses[i], seen[i].ends) for i in chosen], statistics.median(times)


def _cells(pyramid: Pyramid) -> str:
    height, width = pyramid.shape
    return f"{width} x {height}"


def _searched(window: _Window, pyramid: Pyramid, place: Place, rng: np.random.Generator) -> LatticeMatch | None:
    search = window.search
    if window.covariance is None:
        off = rng.uniform(-0.9, 0.9, 3) * [search.window_m, search.window_m, search.window_rad]
    else:
        off = 0.8 * rng.multivariate_normal(np.zeros(3), window.covariance)
    return search.search(pyramid, place.pose + off, window.covariance, place.points)


def main() -> None:
    parser = argparse.ArgumentParser(description="What the search for places costs.")
    parser.add_argument("--queries", type=int, default=20, help="places in each of three simulated buildings")
    report = Report()
    place_search(report, queries=parser.parse_args().queries)
    print(report.summary())


if __name__ == "__main__":
    main()
