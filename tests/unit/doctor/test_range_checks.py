"""Ranges in millimetres, of a frozen laser and at random are named; a robot at rest is not."""

import numpy as np
import pytest

from gridslam.doctor import Doctor, Severity
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate
from support.hand_logs import MadeLog, seen
from support.implausible_ranges import CODES, VARIANTS, found_early

pytestmark = pytest.mark.filterwarnings("ignore:ranges have a median")  # as made here, and found by the doctor


@pytest.fixture(scope="module")
def rooms():
    rng = np.random.default_rng(2)
    return list(simulate(make_world("rooms", rng), RobotConfig(), OdometryNoise(), LidarConfig(), rng).measurements)


def named(measurements):
    """The findings on ranges, of all scans and of those that `map` looks at; they must be the same."""
    doctor = Doctor(matching=False)
    for measurement in measurements:
        doctor.take(measurement)
    found = [f for f in doctor.findings() if f.code in CODES]
    early = [f for f in found_early(MadeLog(measurements)) if f.code in CODES]
    assert [f.code for f in early] == [f.code for f in found]
    return found


@pytest.mark.parametrize("variant", VARIANTS)
def test_each_fault_is_named(rooms, variant):
    due, change = VARIANTS[variant]
    found = named(list(change(rooms[:300])))
    assert [f.code for f in found] == ([due] if due else [])
    assert all(f.severity is Severity.ERROR and f.remedy and f.sensor == "laser" for f in found)


def test_a_laser_is_frozen_only_where_the_robot_moves_and_something_is_hit(rooms):
    first = rooms[0].scan
    log = [seen(k / 5, first.ranges, (0.0, 0.0, 1e-4 * k), first.geometry) for k in range(100)]
    assert named(log) == []
    nothing = np.full(len(first), np.inf)
    assert named([seen(k / 5, nothing, (0.1 * k, 0.0, 0.0), first.geometry) for k in range(100)]) == []


def test_a_laser_that_was_frozen_for_a_while_is_told_with_its_share(rooms):
    turn = next(k for k in range(20, 300) if rooms[k].odometry.pose[0] - rooms[20].odometry.pose[0] > 2)
    log = [m if k < 20 or k > turn else m._replace(scan=rooms[20].scan) for k, m in enumerate(rooms)]
    doctor = Doctor(matching=False)
    for measurement in log:
        doctor.take(measurement)
    (found,) = (f for f in doctor.findings() if f.code == "laser_frozen")
    steps = np.diff([m.odometry.pose[:2] for m in log], axis=0)
    ways = np.hypot(*steps.T)
    assert found.size == pytest.approx(ways[20:turn].sum() / ways.sum(), rel=0.3)


@pytest.mark.parametrize("ranges", [1e300, 1e-300, 5e-324, 1.7e308])
def test_absurd_ranges_and_poses_are_looked_at_without_a_warning(ranges):
    rng = np.random.default_rng(0)
    log = [
        seen(k / 5, ranges * rng.uniform(0.1, 1, 181), (10.0 ** rng.uniform(-9, 15), 0.0, 1e3 * rng.normal()))
        for k in range(100)
    ]
    assert {finding.code for finding in named(log)} <= set(CODES)
