"""Lidars of every kind map a building: few and many beams, any direction, order, count and convention, and two at once.

The trajectory's RMSE over a drive of 60 m, aligned, by the filter with 8 particles; odometry alone loses 0.23 m. Bands
are 1.5 times what was measured, at least.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
import pytest

from gridslam.config import Configuration, build, override
from gridslam.evaluation import PoseErrors, absolute_errors, relative_errors_by_distance
from gridslam.geometry.se2 import between
from gridslam.io.measurement import Measurement
from gridslam.observers import TrajectoryRecorder
from gridslam.pipeline import run
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, SimulatedLog, World, make_world, simulate
from gridslam.sim.floor_plan import box, join
from gridslam.types import LaserScan, ScanGeometry, Trajectory
from simulated import map_drive
from support.faults import with_fault

CONFIG = override(Configuration(), "particles=8")


def lidar(**changes) -> LidarConfig:
    """A full circle of 12 m, 3 scans a second."""
    return LidarConfig(**{"beams": 360, "field_of_view_rad": math.tau, "range_max_m": 12.0, "rate_hz": 3.0} | changes)


def recorded(lidars, robot: RobotConfig | None = None) -> SimulatedLog:
    rng = np.random.default_rng(1)
    return simulate(make_world("rooms", rng), robot or RobotConfig(), OdometryNoise(), lidars, rng)


def mapped(measurements: Iterable[Measurement], truth: Trajectory, config: Configuration = CONFIG) -> PoseErrors:
    recorder = TrajectoryRecorder()
    rng = np.random.default_rng(0)
    state = run(measurements, build(config), rng=rng, observers=[recorder])
    return absolute_errors(recorder.best_trajectory(state), truth)


def error_m(log: SimulatedLog) -> float:
    return mapped(log.measurements, log.truth).trans_rmse_m


@pytest.mark.parametrize(
    ("kind", "band_m"),
    [
        ({"beams": 45}, 0.1),
        ({"beams": 4000, "rate_hz": 1.0}, 0.02),
        ({"clockwise": True}, 0.04),
        ({"beams": 181, "field_of_view_rad": math.pi, "heading_rad": math.pi, "x_m": -0.2}, 0.12),
    ],
    ids=lambda value: (
        " ".join(f"{k}={v:.4}" if isinstance(v, float) else f"{k}={v}" for k, v in value.items())
        if isinstance(value, dict)
        else ""
    ),
)
def test_kinds_of_lidars(kind, band_m):
    assert error_m(recorded(lidar(**kind))) < band_m


def test_another_number_of_beams_in_each_scan():
    log = recorded(lidar(beams=460))
    varied = with_fault(log.measurements, "beam_count_varies", np.random.default_rng(0))
    assert mapped(varied, log.truth).trans_rmse_m < 0.045


def test_bearings_in_no_order_and_at_no_equal_steps():
    """Of each scan 200 of 720 beams, another choice and order each time, in single precision."""
    log, rng = recorded(lidar(beams=720)), np.random.default_rng(0)

    def chosen(scan: LaserScan) -> LaserScan:
        some = rng.choice(720, 200, replace=False)
        ranges, geometry = (
            scan.ranges[some].astype(np.float32),
            ScanGeometry.planar(scan.geometry.bearings[some], [0.1, 0.0, 0.0]),
        )
        return LaserScan.from_ranges(scan.stamp_ns, ranges, geometry, range_max_m=scan.range_max_m)

    assert mapped([Measurement(m.odometry, chosen(m.scan)) for m in log.measurements], log.truth).trans_rmse_m < 0.05


def test_a_hundred_thousand_beams():
    rng = np.random.default_rng(1)
    world = World.of("room", join(box(0, 0, 9, 6), box(4, 4, 5, 5)), [(1.5, 2.0), (7.0, 2.0)])
    log = simulate(world, RobotConfig(), OdometryNoise(), lidar(beams=100_000, rate_hz=1.5), rng)
    assert 400 < max(len(m.scan.beams(0.05, 30.0)) for m in log.measurements) < 3000
    assert mapped(log.measurements, log.truth).trans_max_m < 0.02


@pytest.mark.parametrize("said", ["max", "nan"])
def test_where_nothing_ever_returns_the_odometry_is_all_there_is(said):
    log = recorded(lidar(beams=10, no_return_probability=1.0, no_return=said))
    odometry = absolute_errors(log.odometry, log.truth).trans_rmse_m
    assert mapped(log.measurements, log.truth).trans_rmse_m == pytest.approx(odometry, rel=1e-6)


@pytest.mark.parametrize("beams", [1, 3, 9])
def test_a_handful_of_beams_does_not_say_where_the_robot_is(beams):
    """They fit almost anywhere; the odometry is all there is."""
    log = recorded(lidar(beams=beams))
    odometry = absolute_errors(log.odometry, log.truth).trans_rmse_m
    assert mapped(log.measurements, log.truth).trans_rmse_m < 1.05 * odometry


def test_scans_taken_while_turning_at_three_radians_a_second():
    """Told when each beam was measured, they are deskewed; untold, the turn smears them by up to 0.3 rad."""
    quick = RobotConfig(omega_max_rad_s=3.0, v_max_m_s=1.0, acceleration_m_s2=2.0, turning_radius_m=0.3)
    log = recorded(lidar(rate_hz=10.0, scan_time_s=0.1, reports_beam_times=True), quick)
    error = mapped(log.measurements, log.truth)
    assert error.rot_rmse_deg < 1.2


def test_a_laser_of_short_range_is_better_than_its_odometry():
    """By 0.45 of it: where each scan counts fully in all its pairs 0.58, where the odometry has no weight 0.8."""
    lidar = LidarConfig(beams=240, field_of_view_rad=math.radians(240), range_max_m=4.0, sigma_range_m=0.02)
    rng = np.random.default_rng(201)
    log = simulate(make_world("random", rng), RobotConfig(), OdometryNoise(), lidar, np.random.default_rng(201))
    _, full = map_drive(log.measurements, Configuration(), 0)
    odometry = np.array([reading.pose for reading, _ in log.measurements])
    odometry_m, final_m = (
        relative_errors_by_distance(
            Trajectory(log.truth.stamps_ns, between(poses[0], poses)), log.truth, 1.0
        ).trans_rmse_m
        for poses in (odometry, full.poses)
    )
    assert odometry_m == pytest.approx(0.022, abs=0.001)
    assert final_m < 0.5 * odometry_m
