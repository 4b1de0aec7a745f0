"""The driven path obeys the robot's limits; odometry errs as configured."""

import math

import numpy as np
import pytest

from gridslam.geometry import se2
from gridslam.sim.robot import OdometryNoise, RobotConfig, simulate_odometry
from support.drives import drive

ROUTE = np.array([(0, 0), (6, 0), (6, 4), (2, 4), (2, 1.5), (2, 3), (0.5, 2.0), (0.5, 1.0)], dtype=float)


def test_straight_drive_speeds_up_and_brakes_as_worked_out_by_hand():
    robot = RobotConfig(v_max_m_s=0.5, acceleration_m_s2=0.25)
    poses = drive(np.array([[1.0, 2.0], [1.0, 6.0]]), robot, 0.5)
    # 0.5 m and 2 s each to speed up and to brake, 3 m at full speed: 10 s.
    assert len(poses) == 21
    t = 0.5 * np.arange(21)
    up, down = 0.125 * t**2, 4 - 0.125 * (10 - t) ** 2
    along = np.where(t < 2, up, np.where(t < 8, 0.5 + 0.5 * (t - 2), down))
    np.testing.assert_allclose(poses[:, 1] - 2.0, along, atol=1e-9)
    np.testing.assert_allclose(poses[:, [0, 2]], np.tile([1.0, math.pi / 2], (21, 1)), atol=1e-12)


def test_limits_hold_on_a_winding_route():
    robot, period = RobotConfig(), 0.02
    poses = drive(ROUTE, robot, period)
    twists = se2.log(se2.between(poses[:-1], poses[1:])) / period
    assert twists[:, 0].min() > -1e-9
    assert twists[:, 0].max() <= robot.v_max_m_s + 1e-9
    assert np.abs(twists[:, 2]).max() <= robot.omega_max_rad_s + 1e-9
    # Where a step joins arc and straight, its twist is a little shorter than the way.
    assert np.abs(np.diff(twists[:, 0])).max() / period <= 1.05 * robot.acceleration_m_s2
    assert twists[:, 0].max() > 0.99 * robot.v_max_m_s
    # No wheel slips sideways: only where a step joins arc and straight does its chord leave the arc a little.
    assert np.abs(twists[:, 1]).max() < 0.01


def test_systematic_error_in_closed_form():
    line = np.stack([np.linspace(0, 10, 51), np.zeros(51), np.zeros(51)], axis=1)
    rng = np.random.default_rng(0)
    scaled = simulate_odometry(line, OdometryNoise(1.02, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0), rng)
    assert scaled[-1] == pytest.approx([10.2, 0.0, 0.0])
    # A bias of the wheels makes a straight line an arc: of radius 1 / bias, exactly.
    bent = simulate_odometry(line, OdometryNoise(1.0, 1.0, 0.05, 0.0, 0.0, 0.0, 0.0), rng)
    assert bent[-1] == pytest.approx([math.sin(0.5) / 0.05, (1 - math.cos(0.5)) / 0.05, 0.5])
    spin = np.stack([np.zeros(51), np.zeros(51), np.linspace(0, 2, 51)], axis=1)
    assert simulate_odometry(spin, OdometryNoise(1.0, 0.9, 0.0, 0.0, 0.0, 0.0, 0.0), rng)[-1, 2] == pytest.approx(1.8)


@pytest.mark.parametrize("steps", [20, 60])
def test_random_error_grows_with_the_way_and_not_with_the_number_of_readings(steps):
    """Moving 8 m and 2 rad: the heading's variance is 2 alpha1 + 8 alpha2, the distance's 8 alpha3 + 2 alpha4."""
    noise = OdometryNoise(1.0, 1.0, 0.0, alpha1=4e-4, alpha2=1e-4, alpha3=3e-4, alpha4=2e-4)
    truth = np.empty((steps + 1, 3))
    truth[0] = 0.0
    for k in range(steps):
        truth[k + 1] = se2.compose(truth[k], se2.exp([8 / steps, 0.0, 2 / steps]))
    rng, runs = np.random.default_rng(4), 300
    heading, way = np.empty(runs), np.empty(runs)
    for run in range(runs):
        odometry = simulate_odometry(truth, noise, rng)
        twists = se2.log(se2.between(odometry[:-1], odometry[1:]))
        heading[run], way[run] = twists[:, 2].sum() - 2, twists[:, 0].sum() - 8
    # A sample variance of n normal errors has the relative standard deviation sqrt(2 / (n - 1)): five of them are 0.41.
    tolerance = 5 * math.sqrt(2 / (runs - 1))
    assert heading.var(ddof=1) == pytest.approx(2 * 4e-4 + 8 * 1e-4, rel=tolerance)
    assert way.var(ddof=1) == pytest.approx(8 * 3e-4 + 2 * 2e-4, rel=tolerance)
    assert abs(heading.mean()) < 5 * math.sqrt(1.6e-3 / runs)
    assert abs(way.mean()) < 5 * math.sqrt(2.8e-3 / runs)
