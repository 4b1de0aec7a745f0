"""A building of which half is mapped, and starts anywhere in it: is a robot outside that half found somewhere in it?"""

from __future__ import annotations

from functools import cache

import numpy as np

from gridslam.geometry.se2 import between
from gridslam.localization import KnownMap, MonteCarloLocalization
from gridslam.mapping import OccupancyGridMapping
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, SimulatedLog, make_world, simulate, vary_route

SCANS = 900
WRONG_M = 0.5


@cache
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


def localize_from(known: KnownMap, drive: SimulatedLog, start: int, seed: int) -> dict[str, int]:
    """Localize globally from a scan on; count scans inside and outside, those found there, and those found wrongly."""
    mcl, rng = MonteCarloLocalization(known), np.random.default_rng(seed)
    state = mcl.init()
    counts = dict.fromkeys(("inside", "outside", "found_inside", "found_outside", "wrong"), 0)
    for (odometry, scan), truth in zip(
        drive.measurements[start : start + SCANS], drive.truth.poses[start : start + SCANS], strict=True
    ):
        state, report = mcl.step(state, odometry, scan, rng)
        where = "inside" if known.is_free(truth[None])[0] else "outside"
        counts[where] += 1
        counts[f"found_{where}"] += not report.lost
        counts["wrong"] += bool(not report.lost and np.hypot(*(report.pose - truth)[:2]) > WRONG_M)
    return counts
