"""Large worlds: the cost of a scan does not depend on how much was mapped, and a scan every metre is enough."""

from __future__ import annotations

import math

import numpy as np
import pytest

import gridslam
from gridslam.evaluation import absolute_errors
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, World, simulate
from gridslam.sim.floor_plan import box, join, place
from support.timed import drive

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


@pytest.mark.parametrize("side_m", [50.0, 150.0, 300.0])
def test_a_scan_costs_at_the_end_what_it_costs_at_the_beginning(side_m, record_property):
    rng = np.random.default_rng(3)
    log = simulate(ring(side_m, rng), RobotConfig(v_max_m_s=1.2), OdometryNoise(), LidarConfig(), rng)
    state, poses, seconds = drive(log.measurements, rng)
    # The first side and the third, without the corners; the fourth sees the first again, where the loop closes.
    count = len(seconds)
    early, late = (np.median(seconds[int(a * count) : int(b * count)]) for a, b in ((0.03, 0.22), (0.53, 0.72)))
    megabytes = state.maps.nbytes / 1e6
    errors = absolute_errors(gridslam.Trajectory(log.truth.stamps_ns, poses), log.truth)
    record_property("key scan, ms", f"{1e3 * early:.2f} on the first side, {1e3 * late:.2f} on the third")
    record_property("maps", f"{megabytes:.0f} MB, {1e3 * megabytes / (4 * side_m):.0f} kB a metre")
    record_property("ATE", f"{errors.trans_rmse_m:.2f} m in {4 * side_m:.0f} m")
    assert late < 1.25 * early  # flat; medians of CPU times scatter by a tenth, and views differ a little
    # Shared tiles: 30 maps of a corridor cost less than 10 maps. 2.4 m x 1 m with 0.5 m of field on both sides are
    # 3.4 m2 or 1360 cells of 3 bytes, 4 kB; tiles of 1.6 m and what is seen through their corners double it.
    assert 1e6 * megabytes / (4 * side_m) < 10 * 8e3 + 2e7 / side_m
