"""One figure of speed, printed as JSON: python benchmarks/speed_parts.py PART BENCHMARKS.

`speed.py` runs it for two commits, each with its own folder of benchmarks, whose helpers it takes.
"""

from __future__ import annotations

import json
import math
import sys
import time
from itertools import islice
from typing import Any

import numpy as np

_CORRIDOR_M = 2.4


def mcl(particles: int = 10_000, count: int = 180, updates: int = 100) -> dict[str, float]:
    """CPU ms of an update of Monte Carlo localization in a hall of 40 m x 40 m with 600 pillars, one thread."""
    from gridslam.localization import KnownMap, MonteCarloConfiguration, MonteCarloLocalization
    from gridslam.localization.kld_sampling import KldSampling
    from gridslam.particles.policies import AlwaysResample, MotionThreshold
    from gridslam.types import LaserScan, OccupancyGrid, Odometry, ScanGeometry

    rng, cells = np.random.default_rng(0), np.full((800, 800), -4.0, np.float32)
    cells[[0, -1]] = cells[:, [0, -1]] = 4.0
    for row, column in rng.integers(2, 796, (600, 2)):
        cells[row : row + 3, column : column + 3] = 4.0
    known = KnownMap(OccupancyGrid(cells, np.ones(cells.shape, bool), 0.05, (0.0, 0.0)))
    parts = MonteCarloConfiguration(
        kld=KldSampling(particles_min=particles, particles_max=particles),
        max_beams=count,
        when_to_update=MotionThreshold(1e-9, 1.0),
        when_to_resample=AlwaysResample(),
    )
    slam, rng = MonteCarloLocalization(known, parts), np.random.default_rng(0)
    truth, bearings = np.array([20.0, 20.0, 0.0]), np.linspace(-math.pi / 2, math.pi / 2, count)
    directions = np.column_stack([np.cos(bearings), np.sin(bearings)])
    state, drive = slam.init(truth + 0.1 * rng.standard_normal((particles, 3))), []
    for k in range(updates):
        pose = truth + np.array([0.01 * k, 0.0, 0.0])
        ranges = known.cast_rays(np.zeros(1), pose[None], np.zeros(2), directions, 30.0)[0]
        drive.append((Odometry.at(k, pose), LaserScan.from_ranges(k, ranges, ScanGeometry(bearings), range_max_m=30.0)))
    begin = time.process_time()
    for odometry, scan in drive:
        state, _ = slam.step(state, odometry, scan, rng)
    return {"ms": 1e3 * (time.process_time() - begin) / updates}


def dense(scans: int = 2000) -> dict[str, float]:
    """Latency (ms) of scans of 1080 beams after the first, 40 a second, through the filter with loop closure."""
    import gridslam
    from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate

    lidar = LidarConfig(beams=1080, field_of_view_rad=math.radians(270), rate_hz=40.0)
    rng = np.random.default_rng(0)
    drive = simulate(make_world("demo", rng), RobotConfig(), OdometryNoise(), lidar, rng)
    slam, rng = gridslam.build(gridslam.Configuration()), np.random.default_rng(0)
    measurements, seconds = iter(drive.measurements), []
    state, _ = slam.init(*next(measurements))
    for odometry, scan in islice(measurements, scans):
        begin = time.perf_counter()
        state, _ = slam.step(state, odometry, scan, rng)
        seconds.append(time.perf_counter() - begin)
    return {"p99_ms": 1e3 * float(np.percentile(seconds, 99)), "longest_ms": 1e3 * max(seconds)}


def ring(side_m: float, rng: np.random.Generator) -> Any:  # noqa: ANN401
    """A corridor around a square building, cabinets on both sides; the route goes along three of its four sides.

    What the robot sees at a time is alike at every size, and it never comes back to where it was.
    """
    from gridslam.sim import World
    from gridslam.sim.floor_plan import box, join, place

    inner = side_m - _CORRIDOR_M
    sides = [(0, 0, 0), (side_m, 0, math.pi / 2), (side_m, side_m, math.pi), (0, side_m, -math.pi / 2)]
    cabinets = [place(_cabinets(side_m, rng), side) for side in sides]
    walls = join(box(0, 0, side_m, side_m), box(_CORRIDOR_M, _CORRIDOR_M, inner, inner), *cabinets)
    near, far = _CORRIDOR_M / 2, side_m - _CORRIDOR_M / 2
    return World.of(f"ring{side_m:g}", walls, [(4.0, near), (far, near), (far, far), (4.0, far)])


def _cabinets(length_m: float, rng: np.random.Generator) -> np.ndarray:
    """Boxes along a corridor on the x axis, clear of its corners, now on one wall and now on the other."""
    from gridslam.sim.floor_plan import box, join

    boxes, x = [], 1.5 * _CORRIDOR_M
    while (x := x + rng.uniform(1.0, 5.0)) < length_m - 2 * _CORRIDOR_M:
        width, depth = rng.uniform(0.5, 1.8), rng.uniform(0.25, 0.5)
        y = 0.0 if rng.random() < 0.5 else _CORRIDOR_M - depth
        boxes.append(box(x, y, x + width, y + depth))
        x += width
    return join(*boxes)


def map_size(last: int = 300) -> dict[str, float]:
    """CPU of a scan at the end of a drive about a building of 1 km over that about one of 50 m."""
    import gridslam
    from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, simulate

    means = []
    for side in (50.0, 1000.0):
        world, rng = ring(side, np.random.default_rng(0)), np.random.default_rng(0)
        drive = simulate(world, RobotConfig(v_max_m_s=1.2), OdometryNoise(), LidarConfig(), rng)
        slam, rng, state, clock = gridslam.build(gridslam.Configuration()), np.random.default_rng(0), None, []
        for odometry, scan in drive.measurements:
            state, _ = slam.step(state, odometry, scan, rng) if state else slam.init(odometry, scan)
            clock.append(time.process_time())
        means.append(float(np.diff(clock)[-last:].mean()))
    return {"ratio": means[1] / means[0]}


PARTS = {part.__name__: part for part in (mcl, dense, map_size)}

if __name__ == "__main__":
    sys.path.insert(0, sys.argv[2])
    print(json.dumps(PARTS[sys.argv[1]]()))
