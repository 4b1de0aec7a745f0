"""Simulated drives that judge loop closure: some made to deceive, campuses of 2 km, and grounds."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import final

import numpy as np

from aliasing_worlds import VARIANTS, make_world
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, SimulatedLog, World, simulate

DECEPTIVE = (*VARIANTS, "moved_furniture")

_FAST = RobotConfig(v_max_m_s=0.8, turning_radius_m=0.7)


@final
@dataclass(frozen=True)
class Drive:
    """A robot in a world, with all that its log is made from."""

    name: str
    world: World
    robot: RobotConfig
    odometry: OdometryNoise
    lidar: LidarConfig
    seed: int

    def simulate(self) -> SimulatedLog:
        """Simulate it, from the start each time; the same bytes each time."""
        rng = np.random.default_rng([self.seed, 1])
        return simulate(self.world, self.robot, self.odometry, self.lidar, rng)


def course(kind: str, seed: int) -> Drive:
    """One of the worlds made to deceive, the campus, the grounds, or a world of `gridslam.sim` with its defaults."""
    if kind in DECEPTIVE:
        return deceptive(kind, seed)
    if kind in LARGE:
        return LARGE[kind](seed)
    world = make_world(kind, np.random.default_rng(seed))
    return Drive(f"{kind} {seed}", world, RobotConfig(), OdometryNoise(), LidarConfig(), seed)


def deceptive(kind: str, seed: int) -> Drive:
    """One of the worlds made to deceive; of the kinds that have variants, the seeds take these in turn.

    Odometry turns by 3 to 5 degrees in 100 m and is 2 % long or short. After 100 m that is some metres, no less than
    from one of the equal rooms or parallel corridors to the next.
    """
    rng = np.random.default_rng(seed)
    variants = VARIANTS.get(kind)
    world = make_world(kind, rng) if variants is None else variants[seed % len(variants)](rng)
    odometry = _drifting(rng, math.radians(rng.uniform(3, 5)) / 100, alpha2=1e-5)
    return Drive(f"{kind} {seed}", world, RobotConfig(), odometry, LidarConfig(), seed)


def campus(seed: int) -> Drive:
    """2 km in corridors up to 200 m long; the odometry's heading drifts by 80 to 160 degrees, and walks at random.

    A laser like SICK's: 180 beams over 180 degrees, 1.5 cm of noise.
    """
    rng = np.random.default_rng(seed)
    world = make_world("campus", rng)
    odometry = _drifting(rng, math.radians(rng.uniform(40, 80)) / 1000, alpha2=1e-4)
    lidar = LidarConfig(range_max_m=50.0, sigma_range_m=0.015)
    return Drive(f"campus {seed}", world, _FAST, odometry, lidar, seed)


def grounds(seed: int) -> Drive:
    """1 km to 3 km outdoors and in corridors, a scan about every metre, of 80 m at the most.

    The odometry's heading drifts by 20 to 60 degrees in 1 km, and tracked motion by a few metres, as on the logs of
    such places.
    """
    rng = np.random.default_rng(seed)
    world = make_world("grounds", rng)
    odometry = _drifting(rng, math.radians(rng.uniform(20, 60)) / 1000, alpha2=1e-4)
    lidar = LidarConfig(range_max_m=80.0, sigma_range_m=0.02, no_return_probability=0.02, rate_hz=0.8)
    return Drive(f"grounds {seed}", world, _FAST, odometry, lidar, seed)


LARGE = {"campus": campus, "grounds": grounds}


def _drifting(rng: np.random.Generator, bias_rad_per_m: float, alpha2: float) -> OdometryNoise:
    """Draw to which side odometry turns, and whether it is 2 % long or short."""
    side, longer = rng.choice([-1.0, 1.0], 2).tolist()
    return OdometryNoise(
        distance_scale=1 + 0.02 * longer,
        turn_scale=1 + float(rng.uniform(-0.005, 0.005)),
        bias_rad_per_m=side * bias_rad_per_m,
        alpha2=alpha2,
    )
