"""Simulated logs: a robot drives through a world, and its odometry, its scans and the truth are kept."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from gridslam.arguments import require_generator
from gridslam.errors import ArgumentError
from gridslam.io.measurement import Measurement
from gridslam.sim.floor_plan import clearance, near
from gridslam.sim.lidar import LidarConfig
from gridslam.sim.people import PeopleConfig, simulate_walkers
from gridslam.sim.robot import Drive, OdometryNoise, RobotConfig, simulate_odometry
from gridslam.sim.scanner import TOGETHER, Scanner
from gridslam.sim.world import World
from gridslam.types import FloatArray, IntArray, Odometry, Trajectory

__all__ = ["SimulatedLog", "SimulatedStream", "simulate", "simulate_stream"]


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
        Odometry at the same stamps; its first pose is the true one.
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

    def __repr__(self) -> str:
        """Return one line."""
        return f"SimulatedLog({len(self)} scans, {self.truth})"


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

    def __repr__(self) -> str:
        """Return one line."""
        return f"SimulatedStream({len(self)} scans, {self.truth})"


def simulate(
    world: World,
    robot: RobotConfig,
    odometry: OdometryNoise,
    lidar: LidarConfig | Sequence[LidarConfig],
    rng: np.random.Generator,
    *,
    people: PeopleConfig | None = None,
) -> SimulatedLog:
    """Drive `world`'s route once and record scans, each with odometry: of one lidar, or of several merged by time.

    Stamps begin at 0. The same arguments and state of `rng` give identical results. People stand still during a scan.

    Raises
    ------
    ArgumentError
        If the robot would touch a wall, or no scan is taken during its drive.
    """
    stream = simulate_stream(world, robot, odometry, lidar, rng, people=people)
    return SimulatedLog(tuple(stream.measurements), stream.truth, stream.odometry, stream.walls)


def simulate_stream(
    world: World,
    robot: RobotConfig,
    odometry: OdometryNoise,
    lidar: LidarConfig | Sequence[LidarConfig],
    rng: np.random.Generator,
    *,
    people: PeopleConfig | None = None,
) -> SimulatedStream:
    """Do what `simulate` does, bit for bit, but make each measurement when it is asked for: for logs of any length.

    `rng` is left as `simulate` leaves it, at once: what is drawn from it while the stream is read changes nothing.

    Raises
    ------
    ArgumentError
        If the robot would touch a wall, or no scan is taken during its drive.
    """
    require_generator(rng)
    lidars = [lidar] if isinstance(lidar, LidarConfig) else list(lidar)
    way = Drive(world.route, robot)
    times = [one.times(way.duration_s) for one in lidars]
    if not any(map(len, times)):
        raise ArgumentError("lidar", f"a scan in the {way.duration_s:.1f} s of the drive", "none")
    order = np.argsort(np.concatenate(times), kind="stable")  # a scan of the first lidar before others of its time
    seconds = np.concatenate(times)[order]
    truth, legs = way.at(seconds)
    _check_clearance(world, truth, legs, robot)
    measured = simulate_odometry(truth, odometry, rng)
    crowd = (people, simulate_walkers(world.route, people, rng)) if people is not None and people.count else None
    scanners = [Scanner(one, way, world, rng) for one in lidars]
    of = np.repeat(np.arange(len(lidars)), [len(some) for some in times])[order]
    stamps = np.round(1e9 * seconds).astype(np.int64)

    def measurements() -> Iterator[Measurement]:
        scans = [one.scans(truth[of == k], legs[of == k], crowd) for k, one in enumerate(scanners)]
        for k, stamp, pose in zip(of.tolist(), stamps.tolist(), measured, strict=True):
            yield Measurement(Odometry.at(stamp, pose), next(scans[k]))

    return SimulatedStream(measurements(), Trajectory(stamps, truth), Trajectory(stamps, measured), world.walls)


def _check_clearance(world: World, truth: FloatArray, legs: IntArray, robot: RobotConfig) -> None:
    room = np.full(len(truth), np.inf)
    for part, walls in world.stretches(legs, TOGETHER):
        points = truth[part, :2]
        room[part] = clearance(near(walls, points, robot.radius_m), points)
    if room.min() < robot.radius_m:
        x, y, _ = truth[room.argmin()]
        expected = f"a route that keeps {robot.radius_m} m from walls"
        raise ArgumentError("world", expected, f"{room.min():.3f} m at ({x:.2f}, {y:.2f})")
