"""Scan matching alone finds how a laser moved, whatever the lidar, and its cost is bounded."""

import math

import numpy as np
import pytest

from gridslam.geometry.se2 import between, compose
from gridslam.io.measurement import Measurement
from gridslam.types import LaserScan, ScanGeometry
from support.laser_drives import EXACT, laser_motion, log


def errors(motion, truth, apart):
    """Errors (N, 3) of the laser's increments over `apart` scans, and the true ways (N,)."""
    true = compose(truth, motion.mounting)
    step = between(true[:-apart], true[apart:])
    apart_poses = between(motion.poses[:-apart], motion.poses[apart:])
    error = apart_poses - step
    error[:, 2] = np.remainder(error[:, 2] + math.pi, math.tau) - math.pi
    return error, np.hypot(step[:, 0], step[:, 1])


@pytest.mark.parametrize(
    ("beams", "view", "rate"), [(180, math.pi, 5.0), (720, math.pi, 20.0), (360, math.tau, 10.0), (1080, 4.7, 10.0)]
)
def test_increments_are_exact(beams, view, rate):
    """Over a second: 1 cm and 0.3 degrees in the median with ranges of 1 cm noise, and the way within 0.5 %."""
    measurements, truth = log("rooms", int(30 * rate), 0, EXACT, beams, view, rate)
    motion = laser_motion(measurements)
    assert len(motion) == len(measurements)
    assert motion.tracks.max() == 0
    error, way = errors(motion, truth, int(rate))
    assert np.median(np.abs(error), axis=0).max() < 0.01
    assert np.median(np.abs(error[:, 2])) < math.radians(0.3)
    moving = way > 0.2
    assert (way[moving].sum() + error[moving, 0].sum()) / way[moving].sum() == pytest.approx(1.0, abs=0.005)


def test_covariances_hold():
    measurements, truth = log("rooms", 300, 1, EXACT)
    motion = laser_motion(measurements)
    error, _ = errors(motion, truth, 5)
    spread = motion.covariances[:-5] + motion.covariances[5:]
    scores = error[:, :2] / np.sqrt(spread[:, [0, 1], [0, 1]])
    assert np.mean(np.abs(scores) < 2) > 0.9


def test_a_bare_corridor_leaves_the_way_along_it_open():
    bearings, rng = np.linspace(-math.pi, math.pi, 360, endpoint=False) + 0.004, np.random.default_rng(0)
    geometry = ScanGeometry.planar(bearings, [0, 0, 0])
    ranges = 1.225 / np.abs(np.sin(bearings)) + rng.normal(0, 0.005, (3, 360))  # walls in the middle of cells
    scans = [LaserScan.from_ranges(k * 10**8, row, geometry, range_max_m=12.0) for k, row in enumerate(ranges)]
    motion = laser_motion(Measurement(None, scan) for scan in scans)
    variances, axes = np.linalg.eigh(motion.covariances[2, :2, :2])
    assert variances[0] < 0.02**2
    assert variances[1] == pytest.approx(1.0, rel=0.01)
    assert abs(axes[0, 1]) > 0.99
    assert motion.covariances[0, 0, 0] < 0.01**2
