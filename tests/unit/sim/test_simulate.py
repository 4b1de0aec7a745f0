"""Whole simulated logs: what is recorded fits the truth, and the same seed gives the same bytes."""

import numpy as np
import pytest

from gridslam.errors import ArgumentError
from gridslam.geometry import se2
from gridslam.geometry.angles import wrap
from gridslam.sim import (
    Change,
    LidarConfig,
    OdometryNoise,
    PeopleConfig,
    RobotConfig,
    World,
    make_world,
    simulate,
)
from gridslam.sim.floor_plan import box, clearance, polyline

EXACT = OdometryNoise(1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
NOISELESS = LidarConfig(sigma_range_m=0.0, no_return_probability=0.0, x_m=0.15, y_m=-0.05, heading_rad=0.3, rate_hz=1.0)


def _rooms(seed=0, lidar=NOISELESS, odometry=EXACT, people=None):
    rng = np.random.default_rng(seed)
    return simulate(make_world("rooms", rng), RobotConfig(), odometry, lidar, rng, people=people)


def test_without_noise_every_beam_ends_on_a_wall_and_odometry_is_the_truth():
    log = _rooms()
    assert len(log) == len(log.truth) == len(log.odometry) > 100
    for (odometry, scan), pose in zip(log.measurements, log.truth.poses, strict=True):
        beams = scan.beams(0.0, np.inf)
        assert len(beams) == 180
        ends = se2.transform_points(pose, beams.ends)
        assert clearance(log.walls, ends).max() < 1e-9
        assert odometry.pose[:2] == pytest.approx(pose[:2], abs=1e-9)
        assert wrap(odometry.pose[2] - pose[2]) == pytest.approx(0.0, abs=1e-9)


def test_people_only_shorten_beams_and_keep_their_distance():
    people = PeopleConfig(count=4, radius_m=0.2, distance_m=0.8)
    empty, busy = ([m.scan.ranges for m in log.measurements] for log in (_rooms(), _rooms(people=people)))
    shorter = np.array(busy) < np.array(empty) - 1e-9
    assert (np.array(busy) <= np.array(empty)).all()
    assert 0.005 < shorter.mean() < 0.5
    # From the laser, 0.16 m off the robot's centre, a body that keeps 0.8 m is no nearer than 0.8 - 0.2 - 0.16 m.
    assert np.array(busy)[shorter].min() > 0.44 - 0.002


def test_robot_that_does_not_fit_is_refused_with_the_place():
    world = World.of("box", box(0, 0, 4, 2), [(1.0, 1.0), (3.5, 1.0)])
    with pytest.raises(ArgumentError, match=r"world: .*0\.6 m from walls, got 0\.5.* m at \(3\.[45].*, 1\.00\)"):
        simulate(world, RobotConfig(radius_m=0.6), EXACT, NOISELESS, np.random.default_rng(0))


def test_logs_are_what_they_always_were():
    """Taken down when scans were cast one after the other."""
    log = _rooms(3, LidarConfig(rate_hz=2.0), OdometryNoise(), PeopleConfig(count=2))
    assert sum(m.scan.ranges.sum() for m in log.measurements) == pytest.approx(134993.2401222695, rel=1e-12)
    assert log.odometry.poses[-1] == pytest.approx([2.289778533159554, 2.6301774718074427, 2.7027081118604177])


def test_a_change_that_stands_in_the_way_is_refused():
    world = World.of("w", box(0, 0, 10, 4), [(1, 2), (7, 2), (3, 2)], [Change(1, polyline([(5, 0), (5, 4)]))])
    with pytest.raises(ArgumentError, match=r"got 0\.0.* m at \((4\.9|5\.0).*, 2\.00\)"):
        simulate(world, RobotConfig(), EXACT, NOISELESS, np.random.default_rng(0))
