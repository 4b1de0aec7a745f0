"""Simulated drives that the pictures show, and maps of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gridslam import GridFastSlamState, OccupancyGrid
from gridslam.geometry.se2 import between
from gridslam.grid.tiles import TileMaps
from gridslam.mapping import OccupancyGridMapping
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, SimulatedLog, make_world, simulate
from gridslam.types import FloatArray


def drive(
    world: str, seed: int = 1, noise: OdometryNoise | None = None, lidar: LidarConfig | None = None
) -> SimulatedLog:
    """A simulated log; the frame of its map has the robot's first pose as origin."""
    rng = np.random.default_rng(seed)
    robot = RobotConfig(v_max_m_s=1.0)
    return simulate(make_world(world, rng), robot, noise or OdometryNoise(), lidar or LidarConfig(rate_hz=4.0), rng)


def pasts(state: GridFastSlamState) -> FloatArray:
    """Poses (N, T, 3) of all particles at all key scans."""
    return np.stack([state.ancestry.trajectory(particle) for particle in range(len(state.poses))])


def extent(grid: OccupancyGrid, margin: float = 0.5) -> tuple[float, float, float, float]:
    """The box of what is known, m."""
    rows, columns = np.flatnonzero(grid.known.any(1)), np.flatnonzero(grid.known.any(0))
    (x, y), cell = grid.origin, grid.resolution_m
    return (
        x + columns[0] * cell - margin,
        y + rows[0] * cell - margin,
        x + columns[-1] * cell + margin,
        y + rows[-1] * cell + margin,
    )


def mapped(log: SimulatedLog, scans: Sequence[int], mapper: OccupancyGridMapping | None = None) -> TileMaps:
    """A map of some scans, drawn at their true poses seen from the first one."""
    mapper = mapper or OccupancyGridMapping()
    maps, poses = mapper.empty(1), between(log.truth.poses[0], log.truth.poses)
    for k in scans:
        mapper(maps, poses[k][None], log.measurements[k].scan.beams(0.05, 30.0))
    return maps
