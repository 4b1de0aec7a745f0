"""Global localization in simulated buildings: what is reported, and what is true."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from gridslam.geometry.angles import wrap
from gridslam.localization import KnownMap, MonteCarloLocalization
from gridslam.mapping import OccupancyGridMapping
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, SimulatedLog, make_world, simulate

ORDINARY = ("demo", "rooms", "hall", "corridor", "loop", "random", "moved_furniture")
DECEPTIVE = ("equal_rooms", "symmetric", "bare_corridors")
"""Buildings in which places look alike, some of them wherever the robot goes."""


class GlobalRun(NamedTuple):
    """For each scan (N,) of a run: way driven, probability to be lost, lost as reported, pose wrong."""

    driven_m: np.ndarray
    doubt: np.ndarray
    lost: np.ndarray
    wrong: np.ndarray

    @classmethod
    def joined(cls, runs: list[GlobalRun]) -> GlobalRun:
        return cls(*(np.concatenate(column) for column in zip(*runs, strict=True)))

    @property
    def false(self) -> float:
        """Ratio of scans off by more than 1 m or 0.5 rad, of those reported as localized."""
        return float(self.wrong[~self.lost].mean()) if not self.lost.all() else 0.0

    @property
    def missed(self) -> float:
        """Ratio of scans reported as lost, of those at which the pose was right."""
        return float(self.lost[~self.wrong].mean()) if not self.wrong.all() else 0.0


class Building(NamedTuple):
    """The map of a building as one drive made it, poses being known, and another drive."""

    known: KnownMap
    log: SimulatedLog

    @classmethod
    def of(cls, name: str, seed: int) -> Building:
        world, maps = make_world(name, np.random.default_rng(seed)), OccupancyGridMapping().empty(1)
        parts = world, RobotConfig(), OdometryNoise(), LidarConfig(rate_hz=3.0)
        first, second = (simulate(*parts, np.random.default_rng(drive + seed)) for drive in (1000, 2000))
        for (_, scan), pose in zip(first.measurements, first.truth.poses, strict=True):
            maps.update(np.zeros(1, np.int32), pose[None], scan.beams(0.05, 30.0))
        return cls(KnownMap(maps.occupancy(0)), second)

    def localize_globally(self, seed: int, length_m: float = 30.0) -> GlobalRun:
        """Start anywhere on the way, from a uniform belief, and drive on."""
        poses, rng = self.log.truth.poses, np.random.default_rng(seed)
        way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))])
        begin = int(np.searchsorted(way, rng.random() * max(way[-1] - length_m, 0.0)))
        end = int(np.searchsorted(way, way[begin] + length_m))
        doubt, lost, wrong = (np.array(column) for column in zip(*self._follow(begin, end, rng), strict=True))
        return GlobalRun(way[begin:end] - way[begin], doubt, lost, wrong)

    def _follow(self, begin: int, end: int, rng: np.random.Generator) -> Iterator[tuple[float, bool, bool]]:
        mcl = MonteCarloLocalization(self.known)
        state = mcl.init()
        for (odometry, scan), truth in zip(
            self.log.measurements[begin:end], self.log.truth.poses[begin:end], strict=True
        ):
            state, report = mcl.step(state, odometry, scan, rng)
            x, y, turn = report.pose - truth
            yield report.lost_probability, report.lost, bool(np.hypot(x, y) > 1 or abs(wrap(turn)) > 0.5)
