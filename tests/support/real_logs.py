"""The real logs and the bands that their maps must keep; the quick and the long tier differ only in their seeds."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import final

import gridslam
from gridslam.evaluation import RelationErrors, relation_errors
from gridslam.io.log import Log
from gridslam.io.measurement import Measurement
from gridslam.io.trajectories import read_relations, read_tum
from gridslam.types import FloatArray, Odometry, Trajectory


@dataclass(frozen=True)
class Band:
    """A log and the errors by its relations, in m and deg, that each seed must keep, the filter alone, too."""

    log: str
    relations: str
    scans: int
    mean_m: float
    mean_deg: float
    worst_m: float
    filter_m: float


INTEL = Band("intel.clf.bz2", "intel.relations", 13631, 0.0140, 0.23, 0.13, filter_m=0.0175)
ACES = Band("aces.clf.bz2", "aces.relations", 7374, 0.0360, 0.33, 0.45, filter_m=0.0390)
CSAIL = Band("mit-csail.clf.bz2", "mit-csail.relations", 1988, 0.0285, 0.35, 0.35, filter_m=0.0305)
"""Of ten seeds each errs within 0.2 to 1 % of their mean, by the filter alone within 4 %."""

SPARSE = {"acapulco": 0.16, "belgioioso": 0.085, "seattle": 0.065, "freiburg-101": 0.065}
"""Logs of key scans, and how far (m, rms) any seed may be from GMapping's path; ecac047: 14.6, 0.35, 1.8, 0.05 m."""


POSES: dict[tuple[str, int], FloatArray] = {}


def poses_of(data: Path, name: str) -> FloatArray:
    """Poses (N, 3) of all scans of a log, mapped by the defaults, once for all tests of a process.

    Two seeds differ by up to 0.12 m (rms) on ACES.
    """
    log = f"{name}.clf.bz2"
    if (log, 0) not in POSES:
        POSES[log, 0] = gridslam.map_log(data / log).trajectory.poses
    return POSES[log, 0]


def errors_of(
    data: Path, band: Band, seed: int, out: Path, *, loop_closure: bool = True, odometry: bool = True
) -> RelationErrors:
    """Map a log as a user does, look at what was written, and score the trajectory that was."""
    folder, options = out / f"{band.log}-{seed}-{loop_closure}", gridslam.LogOptions(no_odometry=not odometry)
    log = data / band.log
    configuration = gridslam.Configuration() if loop_closure else gridslam.Configuration(loop_closure=None)
    result = gridslam.map_log(log, configuration=configuration, seed=seed, options=options)
    if loop_closure and odometry:
        POSES[band.log, seed] = result.trajectory.poses
    run = result.save(folder)
    assert run["scans"]["read"] == band.scans
    assert bool(run["loop_closure"]) == loop_closure
    trajectory = read_tum(folder / "trajectory.tum")
    assert len(trajectory) == band.scans  # a pose for every scan
    return relation_errors(trajectory, read_relations(data / band.relations))


def check_seed(errors: RelationErrors, band: Band) -> None:
    """Check what every seed keeps."""
    assert errors.exact == 1  # every relation's times are scans' own
    assert errors.trans_mean_m <= band.mean_m
    assert errors.rot_mean_deg <= band.mean_deg
    assert errors.trans_max_m < band.worst_m


@final
class Backwards:
    """A log driven backwards: the same scans and odometry in the reverse order, at mirrored stamps.

    What is seen is the same, so that its map must be as exact; but what is new comes in at the robot's sides, revisits
    are seen late, and readings that were late are early. Nothing was tuned on it.
    """

    def __init__(self, log: Log) -> None:
        measurements = list(log)
        stamps = [scan.stamp_ns for _, scan in measurements]
        self.path = log.path
        self.statistics = log.statistics
        self._sum_ns = min(stamps) + max(stamps)
        self._measurements = measurements[::-1]

    def __iter__(self) -> Iterator[Measurement]:
        """Yield the last scan first."""
        for odometry, scan in self._measurements:
            stamp_ns = self._sum_ns - scan.stamp_ns
            reading = None if odometry is None else Odometry.at(stamp_ns, odometry.pose)
            yield Measurement(reading, replace(scan, stamp_ns=stamp_ns))

    def turn(self, trajectory: Trajectory) -> Trajectory:
        """Give poses of this log their own stamps again, in the order of the log as it was driven."""
        return Trajectory(self._sum_ns - trajectory.stamps_ns[::-1], trajectory.poses[::-1])
