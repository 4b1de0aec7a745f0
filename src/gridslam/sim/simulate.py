"""Simulated logs: a robot drives through a world, and its odometry, its scans and the truth are kept."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from gridslam.arguments import require_generator
from gridslam.checked import checked
from gridslam.errors import ArgumentError
from gridslam.geometry import se2
from gridslam.io.measurement import Measurement
from gridslam.parameters import bounded, parameters
from gridslam.sim.floor_plan import clearance, near
from gridslam.sim.lidar import LidarConfig, cast_rays, disc_ranges, measure
from gridslam.sim.robot import Drive, OdometryNoise, RobotConfig, simulate_odometry
from gridslam.sim.world import World
from gridslam.types import FloatArray, IntArray, LaserScan, Odometry, ScanGeometry, Trajectory

_TOGETHER = 256  # scans cast at a time: 40 m of way at the most, of which only near walls count
_Crowd = Callable[[FloatArray, FloatArray, FloatArray, FloatArray], FloatArray]
"""Robot (N, 3) at times (N,), lasers (N, 1 or B, 3) and bearings (B,) to the ranges (N, B) of the nearest people, m."""


@final
@parameters(frozen=True)
class PeopleConfig:
    """People who walk up and down the robot's route, each at a pace of their own; they make way for the robot.

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

    count: int = bounded(0, ge=0)
    radius_m: float = bounded(0.2, gt=0)
    speed_m_s: float = bounded(1.0, gt=0)
    distance_m: float = bounded(0.8, gt=0)


@final
@dataclass(frozen=True, slots=True, eq=False)
class SimulatedLog:
    """The log of a simulated robot, and the truth.

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


@checked
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
    crowd = _walk(world.route, people or PeopleConfig(), rng)
    of = np.repeat(np.arange(len(lidars)), [len(some) for some in times])[order]
    scans = [_record(one, way, world, (truth[of == k], legs[of == k]), crowd, rng) for k, one in enumerate(lidars)]
    stamps = np.round(1e9 * seconds).astype(np.int64)
    measurements = tuple(
        Measurement(Odometry.at(stamp, pose), next(scans[k]))
        for k, stamp, pose in zip(of.tolist(), stamps.tolist(), measured, strict=True)
    )
    return SimulatedLog(measurements, Trajectory(stamps, truth), Trajectory(stamps, measured), world.walls)


def _check_clearance(world: World, truth: FloatArray, legs: IntArray, robot: RobotConfig) -> None:
    room = np.full(len(truth), np.inf)
    for part, walls in world.stretches(legs, _TOGETHER):
        points = truth[part, :2]
        room[part] = clearance(near(walls, points, robot.radius_m), points)
    if room.min() < robot.radius_m:
        x, y, _ = truth[room.argmin()]
        expected = f"a route that keeps {robot.radius_m} m from walls"
        raise ArgumentError("world", expected, f"{room.min():.3f} m at ({x:.2f}, {y:.2f})")


def _walk(route: FloatArray, people: PeopleConfig, rng: np.random.Generator) -> _Crowd:
    """Let people walk along the route (K, 2) and back for ever."""
    steps = np.diff(route, axis=0)
    nodes = np.concatenate([[0.0], np.cumsum(np.hypot(steps[:, 0], steps[:, 1]))])
    length = nodes[-1]
    begin = rng.uniform(0.0, 2 * length, people.count)
    pace = people.speed_m_s * rng.uniform(0.5, 1.5, people.count)

    def ranges(robot: FloatArray, seconds: FloatArray, lasers: FloatArray, bearings: FloatArray) -> FloatArray:
        at = np.abs(np.mod(begin + pace * seconds[:, None], 2 * length) - length)
        wanted = np.stack([np.interp(at, nodes, route[:, k]) for k in range(2)], axis=-1)
        away = wanted - robot[:, None, :2]
        distance = np.maximum(np.hypot(away[..., 0], away[..., 1]), 1e-9)[..., None]
        kept = robot[:, None, :2] + away * np.maximum(1.0, people.distance_m / distance)
        return disc_ranges(kept, people.radius_m, lasers, bearings)

    return ranges


def _record(
    lidar: LidarConfig,
    way: Drive,
    world: World,
    drive: tuple[FloatArray, IntArray],
    crowd: _Crowd,
    rng: np.random.Generator,
) -> Iterator[LaserScan]:
    """Return scans of one lidar, with the robot at true poses (N, 3) on legs (N,) of its route."""
    truth, legs = drive
    seconds = lidar.times(way.duration_s)
    ranges = np.full((len(seconds), lidar.beams), np.inf)
    for part, walls in world.stretches(legs, _TOGETHER):
        at = (truth[part], seconds[part])
        lasers, to_walls = _cast(lidar, way, walls, *at)
        ranges[part] = np.minimum(to_walls, crowd(*at, lasers, lidar.bearings))
    measured = measure(ranges, lidar, rng)
    geometry = ScanGeometry.planar(lidar.bearings, lidar.mounting)
    beam_times_s = lidar.beam_times_s if lidar.scan_time_s and lidar.reports_beam_times else None
    return (
        LaserScan.from_ranges(
            round(1e9 * stamp_s),
            row,
            geometry,
            range_max_m=lidar.range_max_m,
            sensor=lidar.sensor,
            frame=lidar.sensor,
            beam_times_s=beam_times_s,
        )
        for stamp_s, row in zip(seconds.tolist(), measured, strict=True)
    )


def _cast(
    lidar: LidarConfig, way: Drive, walls: FloatArray, poses: FloatArray, seconds: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Where the laser is, (N, 1, 3), or (N, B, 3) at each beam of scans that take time; and the ranges (N, B)."""
    bearings = lidar.bearings
    if not lidar.scan_time_s:
        lasers = se2.compose(poses, lidar.mounting)
        ascending = slice(None, None, -1 if lidar.clockwise else 1)
        return lasers[:, None], cast_rays(walls, lasers, bearings[ascending], lidar.reach_m)[:, ascending]
    times = seconds[:, None] + lidar.beam_times_s
    moving, _ = way.at(times.ravel())
    lasers = se2.compose(moving, lidar.mounting)
    rays = lasers.copy()
    rays[:, 2] += np.tile(bearings, len(seconds))
    return lasers.reshape(*times.shape, 3), cast_rays(walls, rays, np.zeros(1), lidar.reach_m).reshape(times.shape)
