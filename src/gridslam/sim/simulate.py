"""Simulated logs: a robot drives through a world, and its odometry, its scans and the truth are kept."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass as parameters

from gridslam.errors import ArgumentError
from gridslam.geometry import se2
from gridslam.io.measurement import Measurement
from gridslam.models.parameters import STRICT
from gridslam.sim.floor_plan import clearance
from gridslam.sim.lidar import LidarConfig, cast_rays, disc_ranges, measure
from gridslam.sim.robot import OdometryNoise, RobotConfig, drive, read_odometry
from gridslam.sim.worlds import World
from gridslam.types import FloatArray, LaserScan, Odometry, Trajectory

__all__ = ["PeopleConfig", "SimulatedLog", "simulate"]


@final
@parameters(frozen=True, config=STRICT)
class PeopleConfig:
    """People who walk up and down the robot's route, each at a pace of their own; they step aside for the robot.

    Parameters
    ----------
    count : int, >= 0
    radius_m : float, m, > 0
        Of the disc a beam meets: a body at the height of a lidar.
    speed_m_s : float, m/s, > 0
        Mean pace; individual ones are between half and one and a half of it.
    distance_m : float, m, > 0
        Least distance kept from the robot's centre.
    """

    count: int = Field(default=0, ge=0)
    radius_m: float = Field(default=0.2, gt=0)
    speed_m_s: float = Field(default=1.0, gt=0)
    distance_m: float = Field(default=0.8, gt=0)


@final
@dataclass(frozen=True, slots=True, eq=False)
class SimulatedLog:
    """What a simulated robot recorded, and what was true.

    Attributes
    ----------
    measurements : tuple of Measurement, length N
        Odometry and scan of each step.
    truth : Trajectory
        True poses of the base at the stamps of the scans, in the frame of the walls.
    odometry : Trajectory
        What odometry says at the same stamps; its first pose is the true one.
    walls : (S, 4) float64, m
        Line segments of the floor plan.
    """

    measurements: tuple[Measurement, ...]
    truth: Trajectory
    odometry: Trajectory
    walls: FloatArray

    def __len__(self) -> int:
        """Return the number of scans N."""
        return len(self.measurements)


def simulate(
    world: World,
    robot: RobotConfig,
    odometry: OdometryNoise,
    lidar: LidarConfig,
    rng: np.random.Generator,
    *,
    people: PeopleConfig | None = None,
) -> SimulatedLog:
    """Drive `world`'s route once and record a scan and odometry at the lidar's rate; a scan is taken in an instant.

    Stamps begin at 0. The same arguments and state of `rng` give the same bytes.

    Raises
    ------
    ArgumentError
        If the robot would touch a wall.
    """
    truth = drive(world.route, robot, 1.0 / lidar.rate_hz)
    room = clearance(world.walls, truth[:, :2])
    if room.min() < robot.radius_m:
        x, y, _ = truth[room.argmin()]
        expected = f"a route that keeps {robot.radius_m} m from walls"
        raise ArgumentError("world", expected, f"{room.min():.3f} m at ({x:.2f}, {y:.2f})")
    seconds = np.arange(len(truth), dtype=np.float64) / lidar.rate_hz
    stamps = np.round(1e9 * seconds).astype(np.int64)
    measured = read_odometry(truth, odometry, rng)
    lasers = se2.compose(truth, [lidar.x_m, lidar.y_m, lidar.heading_rad])
    ranges = cast_rays(world.walls, lasers, lidar.bearings)
    if people is not None and people.count:
        centres = _walk(world.route, truth, seconds, people, rng)
        ranges = np.minimum(ranges, disc_ranges(centres, people.radius_m, lasers, lidar.bearings))
    geometry, reach = lidar.geometry, lidar.range_max_m
    measurements = tuple(
        Measurement(Odometry.at(stamp, pose), LaserScan.from_ranges(stamp, row, geometry, range_max_m=reach))
        for stamp, pose, row in zip(stamps.tolist(), measured, measure(ranges, lidar, rng), strict=True)
    )
    return SimulatedLog(measurements, Trajectory(stamps, truth), Trajectory(stamps, measured), world.walls)


def _walk(
    route: FloatArray, robot: FloatArray, seconds: FloatArray, people: PeopleConfig, rng: np.random.Generator
) -> FloatArray:
    """Places (N, P, 2) of people who walk along the route and back for ever, at the times `seconds` (N,)."""
    steps = np.diff(route, axis=0)
    nodes = np.concatenate([[0.0], np.cumsum(np.hypot(steps[:, 0], steps[:, 1]))])
    length = nodes[-1]
    begin = rng.uniform(0.0, 2 * length, people.count)
    pace = people.speed_m_s * rng.uniform(0.5, 1.5, people.count)
    at = np.abs(np.mod(begin + pace * seconds[:, None], 2 * length) - length)
    places = np.stack([np.interp(at, nodes, route[:, k]) for k in range(2)], axis=-1)
    away = places - robot[:, None, :2]
    distance = np.maximum(np.hypot(away[..., 0], away[..., 1]), 1e-9)[..., None]
    return robot[:, None, :2] + away * np.maximum(1.0, people.distance_m / distance)
