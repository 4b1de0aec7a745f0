"""A furnished flat with a way through it, its map by known poses, and the simulator's own noise as a motion model."""

from __future__ import annotations

import math

import numpy as np

from gridslam.geometry.se2 import compose, inverse
from gridslam.mapping import OccupancyGridMapping
from gridslam.models.motion import GaussianIncrement
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, SimulatedLog, World, simulate
from gridslam.sim.floor_plan import box, join
from gridslam.types import OccupancyGrid, Odometry

RANDOM_WALK = OdometryNoise(distance_scale=1.0, turn_scale=1.0, bias_rad_per_m=0.0)
"""Without systematic errors: what a filter can be told."""


def flat() -> World:
    """12 m x 8 m, two rooms and a corridor, no two places alike."""
    walls = [
        box(0, 0, 12, 8), box(0, 3.0, 4.6, 3.1), box(6.0, 3.0, 12, 3.1), box(7.0, 4.6, 7.1, 8.0),
        box(0.6, 0.5, 1.6, 1.2), box(9.5, 0.4, 10.1, 1.9), box(2.0, 6.2, 3.4, 7.0),
        box(10.4, 6.6, 11.2, 7.4), box(5.0, 7.2, 6.2, 8.0),
    ]  # fmt: skip
    way = [(2.6, 1.6), (5.3, 1.6), (5.3, 4.0), (1.5, 4.6), (4.6, 5.2), (6.2, 3.9), (9.5, 4.2), (9.2, 6.6), (11.0, 5.4)]
    return World.of("flat", join(*walls), way)


def drive(seed: int, noise: OdometryNoise = RANDOM_WALK, rate_hz: float = 3.0) -> SimulatedLog:
    """Once along the way."""
    return simulate(flat(), RobotConfig(), noise, LidarConfig(rate_hz=rate_hz), np.random.default_rng(seed))


def flat_map() -> OccupancyGrid:
    """What a robot whose poses are known maps on that way."""
    log, maps = drive(0, rate_hz=5.0), OccupancyGridMapping().empty(1)
    for (_, scan), pose in zip(log.measurements, log.truth.poses, strict=True):
        maps.update(np.zeros(1, np.int32), pose[None], scan.beams(0.05, 30.0))
    return maps.occupancy(0)


class RandomWalk:
    """The motion model of `OdometryNoise` without systematic errors: variances grow with metres and radians."""

    def __init__(self, noise: OdometryNoise = RANDOM_WALK) -> None:
        self.noise = noise

    def __call__(self, increment: np.ndarray) -> GaussianIncrement:
        x, y, turn = (float(value) for value in increment)
        metres, radians, n = math.hypot(x, y), abs(turn), self.noise
        along = math.sqrt(n.alpha3 * metres + n.alpha4 * radians)
        heading = math.sqrt(n.alpha1 * radians + n.alpha2 * metres)
        # The heading walks along the way: at its end the robot is aside by a third of the heading's variance.
        aside = metres * heading / math.sqrt(3)
        return GaussianIncrement.from_std(
            np.asarray(increment), np.array([along, max(aside, 1e-4), max(heading, 1e-4)])
        )


def kidnapped(log: SimulatedLog, last: int, first: int) -> tuple[list, np.ndarray]:
    """Measurements up to scan `last` and from scan `first` on, between which odometry tells nothing; and the truth."""
    before, after = list(log.measurements[: last + 1]), log.measurements[first:]
    carried = compose(before[-1][0].pose, inverse(after[0][0].pose))
    moved = [m._replace(odometry=Odometry.at(m[0].stamp_ns, compose(carried, m[0].pose))) for m in after]
    return before + moved, np.concatenate([log.truth.poses[: last + 1], log.truth.poses[first:]])
