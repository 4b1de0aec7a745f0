"""Ranges in wrong units, frozen lasers and random ranges, and healthy logs of all kinds.

Each simulated world is a building, a hall or a corridor scaled to a width drawn from 3 to 900 m (log-uniform), seen by
a laser drawn at random: 36 to 720 beams over 180 to 360 degrees at 2 to 20 Hz, noise of 0 to 3 cm and of 0 to 3 % of
the range. The robot drives, stands (with and without noise, with odometry that flickers or drifts), or drives or stands
in a crowd. Each log, simulated or real, is checked as it is, with its ranges in other units (and their limit converted,
or left in metres), every tenth scan alone, without odometry, with its laser frozen, and with random ranges.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import islice, takewhile
from pathlib import Path
from typing import NamedTuple

import numpy as np

from gridslam.doctor import EarlyCheck, Finding
from gridslam.doctor.range_units import UNITS
from gridslam.io.log import open_log
from gridslam.io.measurement import Measurement
from gridslam.sim import LidarConfig, OdometryNoise, PeopleConfig, RobotConfig, World, make_world, simulate_stream
from gridslam.sim.floor_plan import box, pillar
from gridslam.types import BeamStatus, LaserScan, Odometry

CODES = ("range_units", "laser_frozen", "random_ranges")
KINDS = ("demo", "random", "loop", "rooms", "hall", "corridor", "empty", "round", "bare")
_PLAIN_GROUP = "drives, rooms and halls of 8 to 100 m"
_BARE = ("corridor", "round", "bare")
_WAYS = ("drives", "drives in a crowd", "stands", "stands in a crowd")
_LOGS = (
    "*.clf.bz2",
    "sparse/*.clf.gz",
    "loops/*.clf.gz",
    "bags/*.bag",
    "bags/turtlebot4_floor",
)


class Drawn(NamedTuple):
    """A log that is healthy, and what it shows."""

    name: str
    way: str
    size_m: float
    measurements: Sequence[Measurement]

    @property
    def group(self) -> str:
        """Kind of log: what the odometry and the walls in view determine differs."""
        if not self.size_m:
            return "real"
        if self.way.startswith("stands"):
            return "stands"
        seen = np.median([np.mean(m.scan.status == BeamStatus.HIT) for m in self.measurements])
        if seen < 0.5 or self.name.split()[0] in _BARE or not 8 < self.size_m < 100:
            return "drives, others"
        return "drives in a crowd" if self.way.endswith("crowd") else _PLAIN_GROUP


def _world(kind: str, size_m: float, rng: np.random.Generator) -> World:
    """A world of that width, and at most 150 m of the way through it."""
    if kind == "empty":
        world = World.of(kind, box(0, 0, 10, 7), [(2, 2), (8, 2.5), (7, 5.5), (2.5, 5), (2, 2)])
    elif kind == "round":
        world = World.of(kind, pillar(5, 5, 5, 256), [(5, 5), (8, 5), (5, 8), (2, 5), (5, 2.5)])
    elif kind == "bare":
        world = World.of(kind, box(0, 0, 100, 2.5), [(30, 1.2), (70, 1.3)])
    else:
        world = make_world(kind, rng)
    extent = np.ptp(world.walls.reshape(-1, 2), axis=0).max()
    factor = size_m / extent
    route = world.route * factor
    ways = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(route, axis=0).T))])
    count = max(2, int(np.searchsorted(ways, 150.0)))
    if ways[count - 1] > 150.0:
        route = route[:2] if count == 2 else route[:count]
        if count == 2:
            route[1] = route[0] + (route[1] - route[0]) * 150.0 / ways[1]
    return World.of(kind, world.walls * factor, route[:count])


def draw(seed: int) -> Drawn:
    """Draw a log of about 70 s."""
    rng = np.random.default_rng([seed, 15])
    kind = KINDS[seed % len(KINDS)]
    way = _WAYS[int(rng.choice(4, p=[0.55, 0.2, 0.15, 0.1]))]
    size_m = float(np.exp(rng.uniform(math.log(3.0), math.log(900.0))))
    world = _world(kind, size_m, rng)
    scale = min(size_m / 20.0, 1.0)
    noiseless = rng.random() < 0.2
    lidar = LidarConfig(
        beams=int(rng.choice([36, 90, 180, 181, 360, 541, 720])),
        field_of_view_rad=math.pi * float(rng.choice([1.0, 1.5, 2.0])),
        range_max_m=float(rng.choice([5.6, 12.0, 30.0, 81.83, 1000.0])),
        no_return=str(rng.choice(["max", "inf", "nan", "zero"])),
        sigma_range_m=0.0 if noiseless else float(rng.uniform(0, 0.03)),
        sigma_range_share=0.0 if noiseless or rng.random() < 0.5 else float(rng.uniform(0, 0.03)),
        no_return_probability=0.0 if noiseless else float(rng.uniform(0, 0.05)),
        x_m=0.05 * scale,
        rate_hz=float(rng.choice([2.0, 5.0, 10.0, 20.0])),
    )
    speed = float(rng.uniform(0.3, 1.2)) * max(scale, 0.3) * (1 if size_m < 100 else rng.uniform(1, 4))
    if way.startswith("stands"):
        begin, end = world.route[:2]
        world = World.of(kind, world.walls, [begin, begin + (end - begin) * 7e-3 / np.hypot(*(end - begin))])
        speed = 1e-4
    robot = RobotConfig(
        v_max_m_s=speed,
        omega_max_rad_s=float(rng.uniform(0.5, 2.0)),
        acceleration_m_s2=max(speed, 0.05),
        turning_radius_m=0.5 * scale,
        radius_m=0.0,
    )
    exact = rng.random() < 0.3
    odometry = (
        OdometryNoise(1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        if exact
        else OdometryNoise(float(rng.uniform(0.95, 1.05)), float(rng.uniform(0.95, 1.05)), float(rng.normal(0, 0.005)))
    )
    people = None
    if way.endswith("crowd"):
        people = PeopleConfig(
            count=int(rng.integers(5, 40)), radius_m=0.2 * max(scale, 0.2), distance_m=0.6 * max(scale, 0.2)
        )
    log = simulate_stream(world, robot, odometry, lidar, rng, people=people)
    kept = list(takewhile(lambda m: m.scan.stamp_ns < 70e9, log.measurements))
    if way == "stands":
        kept = list(_flicker(kept, rng, still=noiseless))
    return Drawn(f"{kind} {size_m:.1f} m, seed {seed}", way, size_m, kept)


def _flicker(log: Sequence[Measurement], rng: np.random.Generator, *, still: bool) -> Iterator[Measurement]:
    """Odometry of a robot at rest: its encoders flicker by a count, its gyro drifts; noise-free scans are identical."""
    drift = rng.uniform(-0.003, 0.003) * (rng.random() < 0.5)
    first = log[0].scan
    for odometry, scan in log:
        assert odometry is not None
        x, y, theta = odometry.pose.tolist()
        pose = (x + 0.001 * rng.integers(0, 2), y, theta + drift * (scan.stamp_ns - first.stamp_ns) * 1e-9)
        seen = replace(first, stamp_ns=scan.stamp_ns) if still else scan
        yield Measurement(Odometry.at(scan.stamp_ns, pose), seen)


def _converted(log: Iterable[Measurement], factor: float, *, limit: bool) -> Iterator[Measurement]:
    """Ranges times a factor; with their limit, or with that left in metres."""
    for odometry, scan in log:
        largest = scan.range_max_m * (factor if limit else 1.0)
        yield Measurement(odometry, _read(scan, np.round(scan.ranges * factor, 3), largest))


def _read(scan: LaserScan, ranges: np.ndarray, range_max_m: float) -> LaserScan:
    return LaserScan.from_ranges(
        scan.stamp_ns,
        ranges,
        scan.geometry,
        range_min_m=scan.range_min_m,
        range_max_m=range_max_m,
        sensor=scan.sensor,
        frame=scan.frame,
        beam_times_s=scan.beam_times_s,
    )


def _frozen(log: Iterable[Measurement]) -> Iterator[Measurement]:
    first: dict[str, LaserScan] = {}
    for odometry, scan in log:
        yield Measurement(odometry, replace(first.setdefault(scan.sensor, scan), stamp_ns=scan.stamp_ns))


def _stuck(log: Iterable[Measurement]) -> Iterator[Measurement]:
    """A frozen view that goes on flickering: 5 mm of noise."""
    rng = np.random.default_rng(0)
    for odometry, scan in _frozen(log):
        noise = np.where(scan.status == BeamStatus.HIT, 0.005 * rng.standard_normal(len(scan)), 0.0)
        yield Measurement(odometry, replace(scan, ranges=np.maximum(scan.ranges + noise, 1e-3)))


def _random(log: Iterable[Measurement], low: float = 0.2, high: float = 10.0) -> Iterator[Measurement]:
    rng = np.random.default_rng(0)
    for odometry, scan in log:
        yield Measurement(odometry, _read(scan, rng.uniform(low, high, len(scan)), math.inf))


def _sparse(log: Iterable[Measurement]) -> Iterator[Measurement]:
    return islice(log, 0, None, 10)


def _bare(log: Iterable[Measurement]) -> Iterator[Measurement]:
    return (Measurement(None, m.scan) for m in log)


Change = Callable[[Iterable[Measurement]], Iterable[Measurement]]


def _unit(factor: float, *, limit: bool = True) -> Change:
    return lambda log: _converted(log, factor, limit=limit)


VARIANTS: Mapping[str, tuple[str, Change]] = {
    "healthy": ("", iter),
    "healthy, every tenth scan": ("", _sparse),
    "healthy, without odometry": ("", _bare),
    **{f"in {unit}": ("range_units", _unit(factor)) for unit, factor in UNITS.items()},
    "in millimetres, limit in m": ("range_units", _unit(1000.0, limit=False)),
    "in feet, limit in m": ("range_units", _unit(UNITS["feet"], limit=False)),
    "in feet, every tenth scan": ("range_units", lambda log: _sparse(_unit(UNITS["feet"])(log))),
    "in millimetres, every tenth scan": ("range_units", lambda log: _sparse(_unit(1000.0)(log))),
    "in centimetres, without odometry": ("range_units", lambda log: _bare(_unit(100.0)(log))),
    "in millimetres, without odometry": ("range_units", lambda log: _bare(_unit(1000.0)(log))),
    "frozen": ("laser_frozen", _frozen),
    "frozen, with noise": ("laser_frozen", _stuck),
    "random": ("random_ranges", _random),
    "random, without odometry": ("random_ranges", lambda log: _bare(_random(log))),
}
"""By name: the finding that is due, and what is done to a healthy log."""


def found_early(log: Iterable[Measurement]) -> list[Finding]:
    """Check the beginning of a log as `gridslam map` does."""
    early = EarlyCheck()
    findings: list[Finding] = []
    for measurement in log:
        findings += early.take(measurement)
        if early.is_complete:
            break
    return [*findings, *early.end()]


def check(log: Iterable[Measurement]) -> tuple[str, ...]:
    """Name the early findings of `CODES`, units by their number in a metre."""
    return tuple(
        f"{f.code} {f.size:.4g}" if f.code == "range_units" and f.size is not None else f.code
        for f in found_early(log)
        if f.code in CODES
    )


def real_logs(folder: Path) -> Iterator[Drawn]:
    """The healthy logs of a folder, up to 3000 scans each; those that are too short or without scans are left out."""
    for pattern in _LOGS:
        for path in sorted(folder.glob(pattern)):
            yield Drawn(path.name, "real", 0.0, list(islice(open_log(path), 3000)))
