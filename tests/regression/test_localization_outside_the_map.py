"""Global localization in buildings of which half is mapped."""

from __future__ import annotations

import numpy as np
import pytest

from gridslam.geometry.se2 import between
from gridslam.localization import KnownMap, MonteCarloLocalization
from gridslam.mapping import OccupancyGridMapping
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, SimulatedLog, make_world, simulate, vary_route

SCANS = 900
"""Three minutes; a place that looks like another one may be told for two seconds."""


def half_mapped(name: str, seed: int) -> tuple[KnownMap, SimulatedLog]:
    """Half of a building, mapped with true poses on one side of a random line, and another drive all around it."""
    rng = np.random.default_rng(seed)
    world = make_world(name, np.random.default_rng(1000 + seed))
    first, second = (
        simulate(driven, RobotConfig(), OdometryNoise(), LidarConfig(), rng)
        for driven in (world, vary_route(world, rng))
    )
    angle = rng.uniform(0, 2 * np.pi)
    side = first.truth.poses[:, :2] @ [np.cos(angle), np.sin(angle)]
    mapper, last = OccupancyGridMapping(), np.full(3, 1e3)
    maps = mapper.empty(1)
    for k in np.flatnonzero(side <= np.median(side)):
        pose = first.truth.poses[k]
        if np.abs(between(last, pose)).max() > 0.1:
            mapper(maps, pose[None], first.measurements[k].scan.beams(0.05, 30.0))
            last = pose
    return KnownMap(maps.occupancy(0)), second


@pytest.mark.parametrize(("name", "seed"), [("demo", 7), ("random", 13)])
def test_a_robot_outside_what_is_mapped_is_not_found_somewhere_in_it(name, seed):
    """Where a fix does not ask for the outside, 14 and 76 scans of these drives are localized in wrong places."""
    known, drive = half_mapped(name, seed)
    mcl, rng = MonteCarloLocalization(known), np.random.default_rng(seed)
    state, found, wrong = mcl.init(), 0, 0
    start = len(drive.measurements) // 4
    for (odometry, scan), truth in list(zip(drive.measurements, drive.truth.poses, strict=True))[start : start + SCANS]:
        state, report = mcl.step(state, odometry, scan, rng)
        found += not report.lost
        wrong += not report.lost and np.hypot(*(report.pose - truth)[:2]) > 0.5
    assert found > SCANS // 10
    assert wrong <= 10
