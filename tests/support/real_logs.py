"""The real logs and the bands that their maps must keep; the quick and the long tier differ only in their seeds."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import gridslam
from gridslam.evaluation import RelationErrors, relation_errors
from gridslam.geometry.angles import wrap
from gridslam.geometry.se2 import between
from gridslam.io.trajectories import read_relations, read_tum


@dataclass(frozen=True)
class Band:
    """What each seed must keep, and what the mean over the seeds must; relations' errors in m and deg."""

    log: str
    relations: str
    scans: int
    mean_m: float
    seed_m: float
    mean_deg: float
    worst_m: float = 0.5


INTEL = Band("intel.clf.bz2", "intel.relations", 13631, mean_m=0.0175, seed_m=0.020, mean_deg=0.30)
ACES = Band("aces.clf.bz2", "aces.relations", 7374, mean_m=0.0375, seed_m=0.045, mean_deg=0.40)
CSAIL, CSAIL_SCANS = "mit-csail.clf.bz2", 1988

CSAIL_END = (-0.531, -0.076, 1.300)
"""Pose of the last scan in the frame of the first: the robot comes back to the room where it started.

Found without the filter's help over the way between: a window search of the last scan in a map of the first 200 scans,
in which 321 of its 354 beams agree, from wherever in the room the search begins.
"""


def errors_of(
    data: Path, band: Band, seed: int, out: Path, *, loop_closure: bool = True, odometry: bool = True
) -> RelationErrors:
    """Map a log as a user does, look at what was written, and score the trajectory that was."""
    folder, options = out / f"{band.log}-{seed}-{loop_closure}", gridslam.LogOptions(no_odometry=not odometry)
    log = data / band.log
    configuration = gridslam.Configuration(particles=30, loop_closure=loop_closure)
    run = gridslam.map_log(log, configuration=configuration, seed=seed, options=options).save(folder)
    assert run["scans"]["read"] == band.scans
    assert bool(run["loop_closure"]) == loop_closure
    trajectory = read_tum(folder / "trajectory.tum")
    assert len(trajectory) == band.scans  # a pose for every scan
    return relation_errors(trajectory, read_relations(data / band.relations))


def check_seed(errors: RelationErrors, band: Band) -> None:
    """What every seed keeps."""
    assert errors.exact == 1  # every relation's times are scans' own
    assert errors.trans_mean_m <= band.seed_m
    assert errors.trans_max_m < band.worst_m


def csail_end_error(data: Path, seed: int) -> tuple[float, float]:
    """Map CSAIL and tell by how much its end is missed, m and rad.

    It has no relations, but who meets its end has closed the loops, and doubled no wall.
    """
    result = gridslam.map_log(data / CSAIL, particles=30, seed=seed)
    assert len(result.trajectory) == CSAIL_SCANS
    assert result.statistics.lost == 0
    x, y, theta = between(result.trajectory.poses[0], result.trajectory.poses[-1]) - CSAIL_END
    return math.hypot(x, y), abs(float(wrap(theta)))


def check_csail(missed_m: float, missed_rad: float) -> None:
    """What every seed keeps."""
    assert missed_m < 0.1  # two cells: the walls of the room coincide
    assert missed_rad < 0.05
