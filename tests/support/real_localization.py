"""Localization on real logs: in the map that was made of the same place, from nothing and after a kidnapping."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

import gridslam
from gridslam.geometry.se2 import compose, inverse
from gridslam.io.log import open_log
from gridslam.io.maps import read_map, write_map
from gridslam.io.measurement import Measurement
from gridslam.localization import KnownMap, LocalizationReport, MonteCarloLocalization
from gridslam.types import Odometry

AFTER_M = 5.0
"""The robot counts as found where it is near for so long a way on."""


class Mapped(NamedTuple):
    """A log, the map that gridslam made of it, and the poses (N, 3) of its scans in that map."""

    measurements: list[Measurement]
    known: KnownMap
    poses: np.ndarray

    @classmethod
    def of(cls, log: Path, folder: Path) -> Mapped:
        """Map a log, write the map, and read it again."""
        result = gridslam.map_log(log, seed=0, configuration=gridslam.Configuration(particles=15))
        write_map(folder / "map.yaml", result.map)
        return cls(list(open_log(log)), KnownMap(read_map(folder / "map.yaml")), result.trajectory.poses)

    def kidnapped(self, first: slice, second: slice) -> tuple[list[Measurement], np.ndarray]:
        """Two parts of the log, between which odometry tells nothing; and the poses."""
        before, after = self.measurements[first], self.measurements[second]
        carried = compose(before[-1].odometry.pose, inverse(after[0].odometry.pose))
        moved = [
            m._replace(odometry=Odometry.at(m.odometry.stamp_ns, compose(carried, m.odometry.pose))) for m in after
        ]
        return before + moved, np.concatenate([self.poses[first], self.poses[second]])


def follow(
    known: KnownMap, measurements: Sequence[Measurement], seed: int, pose: np.ndarray | None = None
) -> list[LocalizationReport]:
    """Localize with default parameters; all reports."""
    mcl, rng = MonteCarloLocalization(known), np.random.default_rng(seed)
    state = mcl.init() if pose is None else mcl.init_gaussian(pose, np.diag([0.04, 0.04, 0.01]), rng)
    reports = []
    for odometry, scan in measurements:
        state, report = mcl.step(state, odometry, scan, rng)
        reports.append(report)
    return reports


def driven_way(measurements: Sequence[Measurement]) -> np.ndarray:
    """Metres (N,) driven up to each scan, by odometry."""
    poses = [np.zeros(3) if m.odometry is None else m.odometry.pose for m in measurements]
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(np.array(poses)[:, :2], axis=0).T))])


def metres(reports: Sequence[LocalizationReport], poses: np.ndarray) -> np.ndarray:
    """How far (N,) each pose is from where the robot was."""
    return np.hypot(*(np.array([report.pose for report in reports]) - poses)[:, :2].T)


def found_after_m(errors: np.ndarray, driven: np.ndarray, near_m: float) -> float:
    """Way until the error stays below `near_m` for the next metres; infinite where it never does."""
    for k in np.flatnonzero(errors < near_m):
        if (errors[k : np.searchsorted(driven, driven[k] + AFTER_M)] < near_m).all():
            return float(driven[k] - driven[0])
    return float("inf")
