"""Simulated logs: a robot drives through a world, and its odometry, its scans and the truth are kept."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from copy import deepcopy
from dataclasses import dataclass
from typing import final

import numpy as np

from gridslam.errors import ArgumentError
from gridslam.geometry import se2
from gridslam.io.measurement import Measurement
from gridslam.sim.floor_plan import clearance, near
from gridslam.sim.lidar import LidarConfig, cast_rays, disc_ranges, measure
from gridslam.sim.people import PeopleConfig, walkers
from gridslam.sim.robot import OdometryNoise, RobotConfig, follow, read_odometry
from gridslam.sim.world import World
from gridslam.types import FloatArray, IntArray, LaserScan, Odometry, Trajectory

__all__ = ["SimulatedLog", "SimulatedStream", "simulate", "simulate_stream"]

_TOGETHER = 256  # scans made at a time: 40 m of way at the most, and some MB of arrays


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
        Line segments of the floor plan, as it is at the start.
    """

    measurements: tuple[Measurement, ...]
    truth: Trajectory
    odometry: Trajectory
    walls: FloatArray

    def __len__(self) -> int:
        """Return the number of scans N."""
        return len(self.measurements)


@final
@dataclass(frozen=True, slots=True, eq=False)
class SimulatedStream:
    """A `SimulatedLog` whose measurements are made when they are asked for, each once, and not kept.

    The rest is known from the start and takes 64 bytes for each scan.
    """

    measurements: Iterator[Measurement]
    truth: Trajectory
    odometry: Trajectory
    walls: FloatArray

    def __len__(self) -> int:
        """Return the number of scans N, those already given included."""
        return len(self.truth)


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
    stream = simulate_stream(world, robot, odometry, lidar, rng, people=people)
    return SimulatedLog(tuple(stream.measurements), stream.truth, stream.odometry, stream.walls)


def simulate_stream(
    world: World,
    robot: RobotConfig,
    odometry: OdometryNoise,
    lidar: LidarConfig,
    rng: np.random.Generator,
    *,
    people: PeopleConfig | None = None,
) -> SimulatedStream:
    """Do what `simulate` does, bit for bit, but make each measurement when it is asked for: for logs of any length.

    `rng` is left as `simulate` leaves it, at once: what is drawn from it while the stream is read changes nothing.

    Raises
    ------
    ArgumentError
        If the robot would touch a wall.
    """
    truth, legs = follow(world.route, robot, 1.0 / lidar.rate_hz)
    _check_clearance(world, truth, legs, robot)
    seconds = np.arange(len(truth), dtype=np.float64) / lidar.rate_hz
    stamps = np.round(1e9 * seconds).astype(np.int64)
    measured = read_odometry(truth, odometry, rng)
    lasers = se2.compose(truth, [lidar.x_m, lidar.y_m, lidar.heading_rad])
    places = walkers(world.route, people, rng) if people is not None and people.count else None

    def blocked(part: slice) -> FloatArray | float:
        if people is None or places is None:
            return np.inf
        return disc_ranges(places(truth[part], seconds[part]), people.radius_m, lasers[part], lidar.bearings)

    noise = _taken(rng, lambda count: rng.standard_normal((count, lidar.beams)), len(truth))
    losses = _taken(rng, lambda count: rng.random((count, lidar.beams)), len(truth))

    def measurements() -> Iterator[Measurement]:
        geometry, reach = lidar.geometry, lidar.range_max_m
        for part, walls in world.stretches(legs, _TOGETHER):
            ranges = cast_rays(walls, lasers[part], lidar.bearings, lidar.reach_m)
            rows = measure(np.minimum(ranges, blocked(part)), lidar, noise, losses)
            for stamp, pose, row in zip(stamps[part].tolist(), measured[part], rows, strict=True):
                scan = LaserScan.from_ranges(stamp, row, geometry, range_max_m=reach)
                yield Measurement(Odometry.at(stamp, pose), scan)

    return SimulatedStream(measurements(), Trajectory(stamps, truth), Trajectory(stamps, measured), world.walls)


def _check_clearance(world: World, truth: FloatArray, legs: IntArray, robot: RobotConfig) -> None:
    room = np.full(len(truth), np.inf)
    for part, walls in world.stretches(legs, _TOGETHER):
        points = truth[part, :2]
        room[part] = clearance(near(walls, points, robot.radius_m), points)
    if room.min() < robot.radius_m:
        x, y, _ = truth[room.argmin()]
        expected = f"a route that keeps {robot.radius_m} m from walls"
        raise ArgumentError("world", expected, f"{room.min():.3f} m at ({x:.2f}, {y:.2f})")


def _taken(rng: np.random.Generator, draw: Callable[[int], FloatArray], count: int) -> np.random.Generator:
    """Copy `rng`, and let it pass over `count` rows that `draw` takes from it: the copy will draw the same."""
    copy = deepcopy(rng)
    for first in range(0, count, _TOGETHER):
        draw(min(_TOGETHER, count - first))
    return copy
