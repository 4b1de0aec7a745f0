"""Bad calls raise the project's own errors, which name the argument, what was expected and what came.

What annotations say is checked for all public functions alike (`tests/unit/test_checked.py`); here is the rest.
"""

from __future__ import annotations

import numpy as np
import pytest

import gridslam
from gridslam.localization import MonteCarloLocalization
from gridslam.particles import Systematic
from gridslam.types import LaserScan, OccupancyGrid, Odometry, ScanGeometry, Trajectory

GEOMETRY = ScanGeometry(np.linspace(-1.0, 1.0, 5))
RANGES, STATUS = np.full(5, 2.0), np.zeros(5, np.uint8)
SCAN = LaserScan.from_ranges(0, RANGES, GEOMETRY)
ODOMETRY = Odometry.at(0, (0.0, 0.0, 0.0))
SLAM = gridslam.GridFastSlam(particles=2)
WEIGHTS = np.full(4, 0.25)


def room() -> OccupancyGrid:
    """A box of walls about free space."""
    odds = np.full((20, 20), -3.0, np.float32)
    odds[0] = odds[-1] = odds[:, 0] = odds[:, -1] = 3.0
    return OccupancyGrid(odds, np.ones(odds.shape, bool), 0.1, (-1.0, -1.0))


MCL = MonteCarloLocalization(gridslam.KnownMap(room()))


@pytest.mark.parametrize("seed", [0, None, "rng"])
def test_a_seed_is_no_generator(seed):
    for call in (
        lambda: gridslam.run([(ODOMETRY, SCAN)], SLAM, rng=seed),
        lambda: SLAM.step(SLAM.init(ODOMETRY, SCAN)[0], ODOMETRY, SCAN, seed),
        lambda: MCL.step(MCL.init(), ODOMETRY, SCAN, seed),
        lambda: Systematic()(WEIGHTS, 4, seed),
    ):
        with pytest.raises(
            gridslam.ArgumentError, match=rf"rng: expected a numpy\.random\.Generator, .*, got {seed!r}"
        ):
            call()


def test_a_refused_call_does_not_consume_the_state():
    state, _ = SLAM.init(ODOMETRY, SCAN)
    for arguments in ((ODOMETRY, SCAN, 0), (SCAN, ODOMETRY, np.random.default_rng(0))):
        with pytest.raises(gridslam.ArgumentError):
            SLAM.step(state, *arguments)
    SLAM.step(state, ODOMETRY, SCAN, np.random.default_rng(0))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: SLAM.init(SCAN, ODOMETRY), "odometry: expected Odometry or None, got a LaserScan"),
        (lambda: SLAM.init(ODOMETRY, ODOMETRY), "scan: expected LaserScan, got a Odometry"),
        (lambda: SLAM.init(ODOMETRY, SCAN, "all"), "particles: expected a number, or finite poses of shape"),
        (lambda: SLAM.init(ODOMETRY, SCAN, 2.5), "particles: expected a number, or finite poses of shape"),
        (lambda: SLAM.init(ODOMETRY, SCAN, (0.0, 0.0, 0.0), 30), "particles: expected a number, or finite poses"),
        (lambda: SLAM.init(ODOMETRY, SCAN, 2, "here"), "pose: expected"),
        (lambda: SLAM.step(SCAN, ODOMETRY, SCAN, RNG), "state: expected GridFastSlamState, got a LaserScan"),
        (lambda: SLAM.step(SLAM.init(None, SCAN), ODOMETRY, SCAN, RNG), "state: expected GridFastSlamState, got a tu"),
        (lambda: MCL.step(MCL.init(), SCAN, ODOMETRY, RNG), "odometry: expected Odometry or None, got a LaserScan"),
        (lambda: gridslam.run("intel.clf.bz2", SLAM, rng=RNG), r"source: expected measurements.*got 'intel.clf.bz2'"),
        (lambda: gridslam.run(7, SLAM, rng=RNG), r"source: expected measurements.*got 7"),
        (lambda: gridslam.run([SCAN], SLAM, rng=RNG), r"source: expected measurements.*got a LaserScan"),
        (lambda: gridslam.map_log("a.clf", repair="some"), "repair: expected needed or none, got some"),
    ],
)
def test_arguments_of_other_kinds_are_told(call, message):
    with pytest.raises(gridslam.ArgumentError, match=message):
        call()


RNG = np.random.default_rng(0)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: LaserScan(0, RANGES[:4], STATUS, GEOMETRY), r"ranges: expected shape \(5,\), got \(4,\)"),
        (lambda: LaserScan(0, RANGES, STATUS[:4], GEOMETRY), r"status: expected shape \(5,\), got \(4,\)"),
        (lambda: LaserScan(0, RANGES, np.full(5, 3, np.uint8), GEOMETRY), "status: expected values of BeamStatus"),
        (lambda: LaserScan(0, RANGES, STATUS, GEOMETRY, -1.0), "range_min_m: expected a finite number >= 0, got -1"),
        (lambda: LaserScan(0, RANGES, STATUS, GEOMETRY, np.nan), "range_min_m: expected a finite number >= 0, got nan"),
        (lambda: LaserScan(0, RANGES, STATUS, GEOMETRY, 1.0, -2.0), "range_max_m: expected a number > range_min_m, 1,"),
        (lambda: LaserScan(0, RANGES, STATUS, GEOMETRY, 0.0, np.nan), "range_max_m: expected a number > range_min_m"),
        (lambda: LaserScan(0, RANGES, STATUS, GEOMETRY, beam_times_s=RANGES[:1]), "beam_times_s: expected shape"),
        (lambda: LaserScan.from_ranges(0, RANGES, GEOMETRY, range_min_m=-0.1), "range_min_m: expected a finite"),
        (lambda: LaserScan.from_ranges(0, [[1.0]], GEOMETRY), r"ranges: expected shape \(5,\)"),
        (lambda: ScanGeometry([0.0, np.nan]), "bearings: expected finite angles in rad"),
        (lambda: ScanGeometry([0.0], np.full((4, 4), np.nan)), "base_from_laser: expected finite numbers"),
        (lambda: ScanGeometry([0.0], np.diag([1.0, 1.0, 1.0, np.nan])), "base_from_laser: expected finite numbers"),
        (lambda: ScanGeometry.planar([0.0], (0.0, 0.0)), r"base_from_laser: expected shape \(3,\)"),
        (lambda: Odometry(0, np.array([0.0, np.inf, 0.0])), "pose: expected finite x, y, theta"),
        (lambda: Trajectory(np.array([0]), np.zeros((1, 2))), r"poses: expected shape \(1, 3\)"),
        (lambda: OccupancyGrid(np.zeros((2, 2)), np.ones((2, 3), bool), 0.1, (0, 0)), "known: expected shape"),
        (lambda: OccupancyGrid(np.zeros((2, 2)), np.ones((2, 2), bool), 0.0, (0, 0)), "resolution_m: expected a fini"),
    ],
)
def test_values_that_contradict_themselves_are_refused(make, message):
    with pytest.raises(gridslam.ArgumentError, match=message):
        make()
