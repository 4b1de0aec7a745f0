"""Scans that a turning robot takes its time for."""

from dataclasses import replace

import numpy as np
import pytest

from gridslam.geometry.se2 import between
from gridslam.mapping import OccupancyGridMapping
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, World, make_world, simulate
from gridslam.sim.floor_plan import furniture, join, room
from gridslam.slam import GridFastSlam, Tracker

BAND_RAD = 0.08
"""Greatest error of the heading. Scans that are taken in an instant leave 0.009 rad; those that take 0.1 s leave 0.06
if deskewed, where the robot turns by 3 rad/s from one scan to the next, which none before could tell; else 0.17."""


def driven(scan_time_s, seed=0):
    """Around a furnished room of 8 m x 6 m at 1 m/s and 3 rad/s; a lidar that turns ten times a second."""
    tables = [furniture(4, 3, 1.2, 0.8, 0.4), furniture(1, 5.4, 1.5, 0.6), furniture(7.3, 1, 0.7, 1.4)]
    route = [(1.5, 1.2), (6.2, 1.3), (6.4, 4.6), (1.6, 4.3), (1.5, 1.6)]
    world = World.of("room", join(room(0, 0, 8, 6), *tables), route)
    lidar = LidarConfig(beams=240, field_of_view_rad=2 * np.pi, rate_hz=10, scan_time_s=scan_time_s)
    robot = RobotConfig(v_max_m_s=1.0, omega_max_rad_s=3.0, acceleration_m_s2=1.5, turning_radius_m=0.3)
    return simulate(world, robot, OdometryNoise(), lidar, np.random.default_rng(seed))


@pytest.fixture(scope="module")
def skewed():
    return driven(0.1)


def track(tracker, measurements):
    """Poses told for each scan, and the state after the last."""
    (odometry, scan), *rest = measurements
    state = tracker.init(odometry, scan.stamp_ns, scan.beams(0.05, 30.0), OccupancyGridMapping())
    told = [state.pose]
    for odometry, scan in rest:
        told.append(tracker.step(state, odometry, scan.stamp_ns, scan.beams(0.05, 30.0)).pose)
    return np.array(told), state


def retimed(log, change, with_odometry=True):
    """The log with other beam times, as `change` makes them of those told."""
    return [
        (odometry if with_odometry else None, replace(scan, beam_times_s=change(scan.beam_times_s)))
        for odometry, scan in log.measurements
    ]


def turned_wrong(told, log):
    """Errors of the heading (rad) of each pose, both in the frame of the first."""
    return np.abs(between(between(log.truth.poses[0], log.truth.poses), told)[:, 2])


def order(state):
    return state.sensors["laser"].best_order


@pytest.mark.parametrize("with_odometry", [True, False])
def test_a_turning_robots_scans_are_sharpened(skewed, with_odometry):
    log = retimed(skewed, lambda times: times, with_odometry)
    told, state = track(Tracker(), log)
    assert turned_wrong(told, skewed).max() < BAND_RAD
    assert order(state) == 1
    as_they_are, _ = track(Tracker(deskew=False), log)
    assert turned_wrong(as_they_are, skewed).max() > 1.8 * BAND_RAD


def test_a_turn_that_reverses_within_a_scan_is_tracked_without_odometry():
    """At 5 scans a second that last 0.18 s, from 1 to -1 rad/s: deskewed by the old turn no place has the scan."""
    lidar = LidarConfig(beams=360, field_of_view_rad=2 * np.pi, range_max_m=12.0, rate_hz=5, scan_time_s=0.18)
    world = make_world("random", np.random.default_rng(104))
    begin = World.of("begin", world.walls, world.route[:13])  # 79 s
    log = simulate(begin, RobotConfig(), OdometryNoise(), lidar, np.random.default_rng(1104))
    told, _ = track(Tracker(), [(None, scan) for _, scan in log.measurements[:340]])
    turns = between(log.truth.poses[:339], log.truth.poses[1:340])[:, 2]
    assert turns[326] > 0.08
    assert turns[327] < -0.19
    assert np.abs(between(told[:-1], told[1:])[:, 2] - turns).max() < 0.08


@pytest.mark.parametrize("with_odometry", [True, False])
def test_beam_times_told_backward_are_noticed(skewed, with_odometry):
    """As of a lidar that turns clockwise, by a driver that does not know; in the last 10 s it is known.

    A scan's pose is then that of its stamp, which is the end of the scan.
    """
    told, state = track(Tracker(), retimed(skewed, lambda times: -times, with_odometry))
    assert order(state) == -1
    end, true_end = between(told[-100], told[-1]), between(skewed.truth.poses[-100], skewed.truth.poses[-1])
    assert np.abs(between(true_end, end)).max() < 0.05


def test_particles_take_the_scan_as_it_was_sharpened(skewed):
    """Mapping the drive from blurred scans leaves more cells occupied: thicker walls."""
    occupied = []
    for deskew in (True, False):
        slam, rng = GridFastSlam(tracker=Tracker(deskew=deskew)), np.random.default_rng(0)
        (odometry, scan), *rest = skewed.measurements
        state, _ = slam.init(odometry, scan, 3)
        for odometry, scan in rest:
            state, _ = slam.step(state, odometry, scan, rng)
        occupied.append(int((state.maps.occupancy(state.best).log_odds > 0).sum()))
    assert occupied[0] < 0.8 * occupied[1]
