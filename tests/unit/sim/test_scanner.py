"""Scans that take time, of lidars of any kind, and of several at once: each beam ends on a wall at its own time."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gridslam.errors import ArgumentError
from gridslam.geometry import se2
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate
from gridslam.sim.floor_plan import clearance
from gridslam.sim.robot import Drive

EXACT = OdometryNoise(1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
QUICK = RobotConfig(omega_max_rad_s=3.0)
SWEEPING = LidarConfig(
    beams=60,
    field_of_view_rad=math.tau,
    sigma_range_m=0.0,
    no_return_probability=0.0,
    x_m=0.15,
    heading_rad=0.3,
    rate_hz=1.0,
    scan_time_s=0.1,
)


def drive(lidar, robot=QUICK, odometry=EXACT, **others):
    rng = np.random.default_rng(0)
    return simulate(make_world("rooms", rng), robot, odometry, lidar, rng, **others)


def replace_parameters(lidar: LidarConfig, **changes) -> LidarConfig:
    return LidarConfig(**{name: getattr(lidar, name) for name in lidar.__dataclass_fields__} | changes)


@pytest.mark.parametrize("clockwise", [False, True])
def test_each_beam_ends_on_a_wall_seen_from_where_the_robot_was_at_its_time(clockwise):
    log = drive(replace_parameters(SWEEPING, clockwise=clockwise))
    way = Drive(make_world("rooms", np.random.default_rng(0)).route, QUICK)
    skewed = 0.0
    for _, scan in log.measurements:
        beams = scan.beams(0.0, np.inf)
        assert len(beams) == 60
        assert scan.beam_times_s == pytest.approx(np.arange(60) / 600)
        moving, _ = way.at(scan.stamp_ns * 1e-9 + scan.beam_times_s)
        assert clearance(log.walls, se2.transform_points(moving, beams.ends)).max() < 1e-6  # of stamps in ns
        at_once, _ = way.at(np.array([scan.stamp_ns * 1e-9]))
        skewed = max(skewed, clearance(log.walls, se2.transform_points(at_once, beams.ends)).max())
    assert skewed > 0.2  # 0.3 rad at some metres


def test_deskewed_with_the_true_twist_it_is_the_scan_of_an_instant():
    """Where the twist is constant during the scan; between the pieces of the way it changes."""
    log = drive(SWEEPING)
    way = Drive(make_world("rooms", np.random.default_rng(0)).route, QUICK)
    exact = 0
    for (_, scan), pose in zip(log.measurements, log.truth.poses, strict=True):
        poses, _ = way.at(scan.stamp_ns * 1e-9 + np.array([0.0, 0.05, 0.1]))
        first, second = se2.log(se2.between(poses[:2], poses[1:])) / 0.05
        ends = scan.beams(0.0, np.inf).deskew(first).ends
        if steady := np.abs(first - second).max() < 1e-6:
            assert clearance(log.walls, se2.transform_points(pose, ends)).max() < 1e-5
        exact += steady
    assert exact > 0.3 * len(log)


def test_several_lidars_are_merged_by_time_with_one_odometry():
    front = replace_parameters(SWEEPING, sensor="front", beams=30, field_of_view_rad=2.0, rate_hz=4.0)
    rear = replace_parameters(
        SWEEPING, sensor="rear", x_m=-0.2, heading_rad=math.pi, beams=45, rate_hz=3.0, begin_s=0.05
    )
    log = drive([front, rear], odometry=OdometryNoise())
    stamps = np.array([scan.stamp_ns for _, scan in log.measurements])
    assert (np.diff(stamps) >= 0).all()
    assert (stamps == log.truth.stamps_ns).all()
    way = Drive(make_world("rooms", np.random.default_rng(0)).route, QUICK)
    for lidar in (front, rear):
        own = [scan for _, scan in log.measurements if scan.sensor == lidar.sensor]
        assert [scan.stamp_ns for scan in own] == np.round(lidar.times(way.duration_s) * 1e9).tolist()
        assert {len(scan) for scan in own} == {lidar.beams}
    for reading, scan in log.measurements:
        moving, _ = way.at(scan.stamp_ns * 1e-9 + scan.beam_times_s)
        ends = scan.geometry.directions * scan.ranges[:, None] + scan.geometry.origin
        assert clearance(log.walls, se2.transform_points(moving, ends)).max() < 1e-6
        assert reading.stamp_ns == scan.stamp_ns
    told, true = (se2.between(way.poses[:-1], way.poses[1:]) for way in (log.odometry, log.truth))
    assert np.abs(told - true).max() < 0.05  # one random walk, no two


def test_one_of_several_lidars_is_as_it_is_alone():
    """Ranges without noise do not depend on what else is on the robot."""
    both = drive([SWEEPING, replace_parameters(SWEEPING, sensor="other", heading_rad=2.0)])
    alone = drive(SWEEPING)
    own = [scan for _, scan in both.measurements if scan.sensor == "laser"]
    for one, (_, other) in zip(own, alone.measurements, strict=True):
        np.testing.assert_array_equal(one.ranges, other.ranges)


@pytest.mark.parametrize("lidar", [[], [replace_parameters(SWEEPING, begin_s=1e4)]])
def test_no_scan_at_all_is_refused(lidar):
    with pytest.raises(ArgumentError, match="lidar: expected a scan in the"):
        drive(lidar)
