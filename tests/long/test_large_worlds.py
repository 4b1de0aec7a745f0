"""The cost of a scan and of a particle's map does not depend on how large the world has become."""

from __future__ import annotations

import math

import numpy as np
import pytest

import gridslam
from gridslam.evaluation import absolute_errors
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, World, simulate
from gridslam.sim.floor_plan import box, join, place

WIDTH_M = 2.4


def ring(side_m: float, rng: np.random.Generator) -> World:
    """A corridor around a square block, with cabinets on its outer wall; once around, and a little farther."""
    boxes = []
    for side in [(0, 0, 0), (side_m, 0, math.pi / 2), (side_m, side_m, math.pi), (0, side_m, -math.pi / 2)]:
        at = np.arange(2 * WIDTH_M, side_m - 2 * WIDTH_M, 4.0)
        widths, depths = rng.uniform(0.5, 2.5, len(at)), rng.uniform(0.2, 0.5, len(at))
        row = join(*(box(x, 0, x + w, d) for x, w, d in zip(at, widths, depths, strict=True)))
        boxes.append(place(row, side))
    inner = side_m - WIDTH_M
    walls = join(box(0, 0, side_m, side_m), box(WIDTH_M, WIDTH_M, inner, inner), *boxes)
    near, far = WIDTH_M / 2 + 0.2, side_m - WIDTH_M / 2 - 0.2
    return World.of("ring", walls, [(8.0, near), (far, near), (far, far), (near, far), (near, near), (12.0, near)])


def drive(side_m: float) -> tuple[list[float], float, float]:
    """Times (s) of the key scans of one way around, MB of maps, and the largest error (m) until the loop closes."""
    rng = np.random.default_rng(3)
    robot, lidar = RobotConfig(v_max_m_s=1.2), LidarConfig(beams=180)
    log = simulate(ring(side_m, rng), robot, OdometryNoise(), lidar, rng)
    seconds, poses = [], []

    def watch(report, state, took):
        poses.append(report.pose)
        if report.skipped is None:
            seconds.append(took)

    state = gridslam.run(log.measurements, gridslam.GridFastSlam(), particles=30, rng=rng, observers=[watch])
    errors = absolute_errors(gridslam.Trajectory(log.truth.stamps_ns, np.array(poses)), log.truth)
    return seconds, state.maps.nbytes / 1e6, errors.trans_max_m


@pytest.fixture(scope="module")
def small():
    return drive(50.0)


@pytest.mark.parametrize("side_m", [100.0, 200.0, 300.0])
def test_a_scan_costs_what_it_costs_in_a_small_world(small, side_m, record_property):
    seconds, megabytes, error_m = drive(side_m)
    ratio = np.median(seconds) / np.median(small[0])
    late = np.median(seconds[-len(seconds) // 5 :]) / np.median(seconds[: len(seconds) // 5])
    per_metre = (megabytes / side_m) / (small[1] / 50.0)
    record_property("key scan", f"{1e3 * np.median(seconds):.2f} ms, {ratio:.2f} of that in 50 m, {late:.2f} late/early")
    record_property("maps", f"{megabytes:.0f} MB, {per_metre:.2f} a metre of that in 50 m")
    record_property("largest error", f"{error_m:.2f} m in {4 * side_m:.0f} m")
    # Flat but for caches: the tables of tiles grow, and a noisy machine's medians scatter by a quarter.
    assert ratio < 1.3
    assert late < 1.3
    # Memory grows with what was seen, not with the square of the extent; shared history grows slower still.
    assert per_metre < 1.3
