"""Localization in simulated buildings, tracked and from nothing: what is reported, and what is true."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from aliasing_worlds import make_world
from gridslam.evaluation.consistency import nees
from gridslam.geometry.angles import wrap
from gridslam.localization import KnownMap, LocalizationReport, MonteCarloLocalization
from gridslam.localization.monte_carlo import MonteCarloConfiguration
from gridslam.localization.state import MonteCarloState
from gridslam.mapping import OccupancyGridMapping
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, SimulatedLog, simulate
from support.faults import with_fault

DECEPTIVE = ("equal_rooms", "symmetric", "bare_corridors")
"""Buildings in which places look alike, some of them wherever the robot goes."""

FIRST = np.diag([0.01, 0.01, 0.0025])
"""Covariance of the first pose where a robot is tracked."""

INSIDE = 7.815
"""NEES of the 95 % ellipsoid: the quantile of chi-square with 3 degrees of freedom."""

_FAST = RobotConfig(v_max_m_s=0.8, turning_radius_m=0.7)


class GlobalRun(NamedTuple):
    """For each scan (N,) of a run: way driven, probability to be lost, lost as reported, pose wrong, NEES."""

    driven_m: np.ndarray
    doubt: np.ndarray
    lost: np.ndarray
    wrong: np.ndarray
    nees: np.ndarray

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

    @property
    def found_after_m(self) -> float:
        """Way to the first scan reported as localized; infinite where there is none."""
        return float(self.driven_m[~self.lost][0]) if not self.lost.all() else math.inf


class Building(NamedTuple):
    """The map of a building as one drive made it, poses being known, and another drive."""

    known: KnownMap
    log: SimulatedLog

    @classmethod
    def of(cls, name: str, seed: int, *, backs_out: bool = False) -> Building:
        """Build it; in the other drive the robot leaves dead ends backward if it `backs_out`."""
        world, maps = make_world(name, np.random.default_rng(seed)), OccupancyGridMapping().empty(1)
        robot = _FAST if name == "campus" else RobotConfig()
        first, second = (
            simulate(world, driven, OdometryNoise(), LidarConfig(rate_hz=3.0), np.random.default_rng(drive + seed))
            for driven, drive in ((robot, 1000), (replace(robot, backs_out=backs_out), 2000))
        )
        for (_, scan), pose in zip(first.measurements, first.truth.poses, strict=True):
            maps.update(np.zeros(1, np.int32), pose[None], scan.beams(0.05, 30.0))
        return cls(KnownMap(maps.occupancy(0)), second)

    def with_fault(self, name: str) -> Building:
        """Give the other drive a fault, one of `support.faults.FAULTS`."""
        faulty = with_fault(self.log.measurements, name, np.random.default_rng(0))
        return self._replace(log=replace(self.log, measurements=tuple(faulty)))

    def localize_globally(
        self, seed: int, length_m: float = 30.0, configuration: MonteCarloConfiguration | None = None
    ) -> GlobalRun:
        """Start anywhere on the way, from a uniform belief, and drive on."""
        mcl, rng = self._filter(configuration), np.random.default_rng(seed)
        return self._drive(mcl, self._begin(length_m, rng), length_m, mcl.init(), rng)

    def track(
        self, seed: int, length_m: float = 30.0, configuration: MonteCarloConfiguration | None = None
    ) -> GlobalRun:
        """The same from a first pose that is off by what its covariance states."""
        mcl, rng = self._filter(configuration), np.random.default_rng(seed)
        begin = self._begin(length_m, rng)
        first = rng.multivariate_normal(self.log.truth.poses[begin], FIRST)
        return self._drive(mcl, begin, length_m, mcl.init_gaussian(first, FIRST, rng), rng)

    def _filter(self, configuration: MonteCarloConfiguration | None) -> MonteCarloLocalization:
        return MonteCarloLocalization(self.known, configuration or MonteCarloConfiguration())

    @property
    def _way_m(self) -> np.ndarray:
        return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(self.log.truth.poses[:, :2], axis=0).T))])

    def _begin(self, length_m: float, rng: np.random.Generator) -> int:
        way = self._way_m
        return int(np.searchsorted(way, rng.random() * max(way[-1] - length_m, 0.0)))

    def _drive(
        self,
        mcl: MonteCarloLocalization,
        begin: int,
        length_m: float,
        state: MonteCarloState,
        rng: np.random.Generator,
    ) -> GlobalRun:
        way = self._way_m
        end = int(np.searchsorted(way, way[begin] + length_m))
        truth = self.log.truth.poses[begin:end]
        reports = list(self._reports(mcl, begin, end, state, rng))
        poses, covariances = (np.array([getattr(one, name) for one in reports]) for name in ("pose", "covariance"))
        x, y, turn = (poses - truth).T
        wrong = (np.hypot(x, y) > 1) | (np.abs(wrap(turn)) > 0.5)
        doubt, lost = (np.array([getattr(one, name) for one in reports]) for name in ("lost_probability", "lost"))
        return GlobalRun(way[begin:end] - way[begin], doubt, lost, wrong, nees(poses, truth, covariances))

    def _reports(
        self, mcl: MonteCarloLocalization, begin: int, end: int, state: MonteCarloState, rng: np.random.Generator
    ) -> Iterator[LocalizationReport]:
        for odometry, scan in self.log.measurements[begin:end]:
            state, report = mcl.step(state, odometry, scan, rng)
            yield report
