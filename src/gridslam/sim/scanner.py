"""What one simulated lidar records along a drive: exact ranges, beam by beam if the robot moves during a scan."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from copy import deepcopy
from typing import final

import numpy as np

from gridslam.geometry import se2
from gridslam.sim.lidar import LidarConfig, cast_rays, cast_single_rays, disc_ranges, measure
from gridslam.sim.people import PeopleConfig
from gridslam.sim.robot import Drive
from gridslam.sim.world import World
from gridslam.types import FloatArray, IntArray, LaserScan, ScanGeometry

__all__ = ["TOGETHER", "Crowd", "Scanner"]

TOGETHER = 256
"""Scans made at a time: 40 m of way at the most, and some MB of arrays."""

Crowd = tuple[PeopleConfig, Callable[[FloatArray, FloatArray], FloatArray]]
"""People, and where they are (N, P, 2) with the robot at poses (N, 3) at times (N,)."""


@final
class Scanner:
    """A lidar on its way through a world.

    `rng` is left as after the whole drive, at once: the scans draw from copies of it.
    """

    def __init__(self, lidar: LidarConfig, way: Drive, world: World, rng: np.random.Generator) -> None:
        """Take from `rng` what the noise of all scans needs."""
        self._seconds = lidar.times(way.duration_s)
        self._lidar, self._way, self._world = lidar, way, world
        self._noise = _taken(rng, lambda rows: rng.standard_normal((rows, lidar.beams)), len(self._seconds))
        self._losses = _taken(rng, lambda rows: rng.random((rows, lidar.beams)), len(self._seconds))
        self._counts = np.full(len(self._seconds), lidar.beams)
        if lidar.fewest_beams:
            self._counts = rng.integers(lidar.fewest_beams, lidar.beams, len(self._seconds), endpoint=True)
        self._geometries: dict[int, ScanGeometry] = {}

    def scans(self, truth: FloatArray, legs: IntArray, crowd: Crowd | None) -> Iterator[LaserScan]:
        """Scans of the robot at true poses (N, 3) on legs (N,) of its route; to be asked for once."""
        for part, walls in self._world.stretches(legs, TOGETHER):
            poses, seconds, counts = truth[part], self._seconds[part], self._counts[part]
            ranges = np.full((len(seconds), self._lidar.beams), np.inf)
            for count in np.unique(counts).tolist():
                some = counts == count
                lasers = self._lasers(poses[some], seconds[some], count)
                ranges[some, :count] = self._cast(walls, lasers, count)
                if crowd is not None:
                    people, places = crowd[0], crowd[1](poses[some], seconds[some])
                    blocked = disc_ranges(places, people.radius_m, lasers, self._lidar.spread(count))
                    ranges[some, :count] = np.minimum(ranges[some, :count], blocked)
            rows = measure(ranges, self._lidar, self._noise, self._losses)
            for at, count, row in zip(seconds.tolist(), counts.tolist(), rows, strict=True):
                yield self._scan(round(1e9 * at), row[:count])

    def _lasers(self, poses: FloatArray, seconds: FloatArray, beams: int) -> FloatArray:
        """Where the laser is, (N, 1, 3), or (N, B, 3) at each beam of scans that take time."""
        if not self._lidar.scan_time_s:
            return se2.compose(poses, self._lidar.mounting)[:, None]
        times = seconds[:, None] + self._lidar.beam_times(beams)
        moving, _ = self._way.at(times.ravel())
        return se2.compose(moving, self._lidar.mounting).reshape(len(seconds), beams, 3)

    def _cast(self, walls: FloatArray, lasers: FloatArray, beams: int) -> FloatArray:
        bearings, reach_m = self._lidar.spread(beams), self._lidar.reach_m
        if self._lidar.scan_time_s:
            rays = lasers + np.stack([np.zeros(beams), np.zeros(beams), bearings], axis=-1)
            return cast_single_rays(walls, rays.reshape(-1, 3), reach_m).reshape(rays.shape[:2])
        ascending = slice(None, None, -1 if self._lidar.clockwise else 1)
        return cast_rays(walls, lasers[:, 0], bearings[ascending], reach_m)[:, ascending]

    def _scan(self, stamp_ns: int, ranges: FloatArray) -> LaserScan:
        lidar, beams = self._lidar, len(ranges)
        if beams not in self._geometries:
            self._geometries[beams] = ScanGeometry.planar(lidar.spread(beams), lidar.mounting)
        return LaserScan.from_ranges(
            stamp_ns, ranges, self._geometries[beams], range_max_m=lidar.range_max_m, sensor=lidar.sensor,
            frame=lidar.sensor,
            beam_times_s=lidar.beam_times(beams) if lidar.scan_time_s and lidar.tells_beam_times else None,
        )  # fmt: skip


def _taken(rng: np.random.Generator, draw: Callable[[int], FloatArray], count: int) -> np.random.Generator:
    """Copy `rng`, and let it pass over `count` rows that `draw` takes from it: the copy will draw the same."""
    copy = deepcopy(rng)
    for first in range(0, count, TOGETHER):
        draw(min(TOGETHER, count - first))
    return copy
