"""Odometry that cannot be true is replaced by the motion from scan to scan; all other is used as it is."""

import numpy as np
import pytest

from gridslam.geometry.se2 import between, compose, inverse
from gridslam.localization import KnownMap, MonteCarloConfiguration, MonteCarloLocalization
from gridslam.sim import OdometryNoise
from gridslam.types import Odometry
from support.faults import reflected_laser
from support.global_localization import Building
from support.localization_world import drive, flat_map

UNCHECKED = MonteCarloConfiguration(odometry_check=None)
SPREAD = np.diag([0.04, 0.04, 0.01])


@pytest.fixture(scope="module")
def known():
    return KnownMap(flat_map())


def follow(known, measurements, truth, configuration=None):
    mcl, rng = MonteCarloLocalization(known, configuration or MonteCarloConfiguration()), np.random.default_rng(0)
    state, reports = mcl.init_gaussian(truth[0], SPREAD, rng), []
    for odometry, scan in measurements:
        state, report = mcl.step(state, odometry, scan, rng)
        reports.append(report)
    metres = np.hypot(*(np.array([report.pose for report in reports]) - truth[: len(reports)])[:, :2].T)
    return reports, metres


def test_odometry_that_counts_reverse_motion_as_forward_does_not_lose_the_robot():
    """It leaves dead ends backward, for 10 m at a time. Unchecked it is lost at a third of the scans and more."""
    building = Building.of("random", 61, backs_out=True).with_fault("unsigned_odometry")
    run = building.track(61)
    assert not run.lost.any()
    assert not run.wrong.any()
    assert building.track(61, configuration=UNCHECKED).lost.mean() > 0.1


def test_healthy_odometry_is_used_as_it_is(known):
    log = drive(1, OdometryNoise(), rate_hz=5.0)
    checked, _ = follow(known, log.measurements, log.truth.poses)
    unchecked, _ = follow(known, log.measurements, log.truth.poses, UNCHECKED)
    assert not any(report.odometry_rejected for report in checked)
    assert [report.pose.tobytes() for report in checked] == [report.pose.tobytes() for report in unchecked]


def reset(measurements, at):
    """Odometry that begins at the origin again."""
    again = inverse(measurements[at].odometry.pose)
    moved = [m._replace(odometry=Odometry.at(m.scan.stamp_ns, compose(again, m.odometry.pose))) for m in measurements]
    return [*measurements[:at], *moved[at:]]


def frozen(measurements, at):
    """Odometry that stands still for four seconds, and then goes on from there."""
    last = measurements[at].odometry.pose
    some = [m._replace(odometry=Odometry.at(m.scan.stamp_ns, last)) for m in measurements[at : at + 20]]
    back = compose(last, inverse(measurements[at + 20].odometry.pose))
    rest = [
        m._replace(odometry=Odometry.at(m.scan.stamp_ns, compose(back, m.odometry.pose)))
        for m in measurements[at + 20 :]
    ]
    return [*measurements[:at], *some, *rest]


@pytest.mark.parametrize("fault", [reset, frozen])
def test_odometry_that_was_reset_or_freezes_does_not_lose_the_robot(known, fault):
    log = drive(2, OdometryNoise(), rate_hz=5.0)
    faulty = fault(list(log.measurements), 80)
    reports, metres = follow(known, faulty, log.truth.poses)
    assert not any(report.lost for report in reports)
    assert metres[5:].max() < 0.2
    assert any(report.odometry_rejected for report in reports)
    assert follow(known, faulty, log.truth.poses, UNCHECKED)[1].max() > 0.3


@pytest.mark.parametrize("factors", [(-1, 1, 1), (1, 1, -1), (1, 1, 0.3)])
def test_odometry_that_is_wrong_throughout_does_not_lose_the_robot(known, factors):
    """Its odometry counts so much of its motion in x, in y and of its turns."""
    log = drive(4, OdometryNoise(), rate_hz=5.0)
    poses = np.array([m.odometry.pose for m in log.measurements])
    wrong = [poses[0]]
    for increment in between(poses[:-1], poses[1:]):
        wrong.append(compose(wrong[-1], increment * factors))
    pairs = zip(log.measurements, wrong, strict=True)
    faulty = [m._replace(odometry=Odometry.at(m.scan.stamp_ns, pose)) for m, pose in pairs]
    reports, metres = follow(known, faulty, log.truth.poses)
    assert not any(report.lost for report in reports)
    assert metres[5:].max() < 0.2


def test_a_mirrored_laser_does_not_find_a_place_by_its_own_motion(known):
    """Its scans contradict all turns of the odometry, and the mirrored motion fits them."""
    log = drive(1, OdometryNoise())
    mcl, rng = MonteCarloLocalization(known), np.random.default_rng(1)
    state = mcl.init()
    rejected = 0
    for odometry, scan in reflected_laser(log.measurements):
        state, report = mcl.step(state, odometry, scan, rng)
        rejected += report.odometry_rejected
        assert report.lost
    assert rejected > 0.5 * len(log)
