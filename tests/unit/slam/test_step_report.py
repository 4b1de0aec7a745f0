"""What the filter tells of each scan: reasons, weights, parents, covariance, where it is lost, what it cannot see."""

import math
from dataclasses import replace
from itertools import takewhile

import numpy as np
import pytest

from gridslam.geometry.se2 import between, rotate_covariances
from gridslam.matching import GaussNewton
from gridslam.particles import AlwaysResample, EffectiveSampleSizeBelow
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, World, make_world, simulate
from gridslam.sim.floor_plan import polyline
from gridslam.slam import GridFastSlam
from gridslam.slam.grid_fastslam.proposals import ScanMatchedProposal
from gridslam.slam.grid_fastslam.report_builder import DRIFT
from gridslam.slam.loop_closure.drift_model import scale_covariances
from gridslam.tracking.tracker import Tracker

PARTICLES = 8


@pytest.fixture(scope="module", params=[EffectiveSampleSizeBelow(), EffectiveSampleSizeBelow(0.98), AlwaysResample()])
def run(request, drive, play):
    slam = GridFastSlam(when_to_resample=request.param)
    return slam, *play(slam, drive.measurements, particles=PARTICLES)


def test_best_stays_until_another_one_has_twenty_times_the_weight_accumulated_along_the_ancestry(run):
    """Accumulated here from what the reports tell: a key scan adds the ratio of the weights after and before it."""
    _, state, reports = run
    accumulated, before = np.zeros(PARTICLES), np.full(PARTICLES, -math.log(PARTICLES))
    best = 0
    for report in reports[1:]:
        if report.skipped:
            assert report.best == best
            continue
        accumulated, before = accumulated + report.log_weights - before, report.log_weights
        if accumulated[best] < accumulated.max() - 3:
            best = int(accumulated.argmax())
        missed = np.abs(between(report.poses[best], report.pose))
        assert (missed < [0.02, 0.02, 0.02]).all()  # less than what a match to cells errs by
        if report.parents is not None:
            accumulated, before = accumulated[report.parents], np.full(PARTICLES, -math.log(PARTICLES))
            away = np.abs(report.poses[report.parents] - report.poses[best])
            best = int(np.square(away).sum(axis=1).argmin())
    assert state.best == best


def test_covariances_are_symmetric_and_positive_definite(run):
    for report in run[2][1:]:
        np.testing.assert_allclose(report.covariance, report.covariance.T, rtol=1e-9, atol=1e-15)
        assert np.linalg.eigvalsh(report.covariance)[0] > 0


def test_between_key_scans_a_random_walk_is_added(run):
    """In proportion to the metres and radians since the last key scan."""
    _, _, reports = run
    key = None
    for report in reports:
        if report.skipped is None:
            key = report
            continue
        added = rotate_covariances(DRIFT.covariance(report.key_from_base), report.pose[2])
        away = np.array([report.pose[:2], key.pose[:2]]) - reports[0].pose[:2]
        of_scale, of_key_scale = scale_covariances(0.002, away)
        grown = report.covariance - added - of_scale
        before = key.covariance - of_key_scale
        assert grown[2, 2] == pytest.approx(before[2, 2], rel=1e-9)
        # what the heading has drifted by since the start turns what follows, too
        turned = float(np.hypot(*(report.pose - key.pose)[:2])) * np.sqrt(before[2, 2])
        of_key, of_scan = (math.sqrt(max(0.0, np.trace(of[:2, :2]))) for of in (before, grown))
        assert of_key - turned - 1e-9 <= of_scan <= of_key + turned + 1e-9


@pytest.fixture(scope="module")
def hall():
    """24 s in another building."""
    rng = np.random.default_rng(1)
    noise, lidar = OdometryNoise(), LidarConfig(beams=120)
    return simulate(make_world("hall", rng), RobotConfig(), noise, lidar, rng).measurements


@pytest.mark.parametrize("start", [0, 100, 300, 500])
def test_a_kidnapped_robot_is_lost(drive, play, hall, start):
    """Carried into another building while its odometry sees nothing of it: the very next key scan tells."""
    at = 70
    log = list(drive.measurements[:at])
    for (odometry, scan), (_, elsewhere) in zip(drive.measurements[at:], hall[start:], strict=False):
        log.append((odometry, replace(elsewhere, stamp_ns=scan.stamp_ns)))
    _, reports = play(GridFastSlam(), log, particles=PARTICLES)
    first = next(k for k, report in enumerate(reports) if k >= at and report.skipped is None)
    assert not any(report.lost for report in reports[:first])
    assert reports[first].lost
    between_keys = [report.lost for report in takewhile(lambda report: report.skipped, reports[first + 1 :])]
    assert all(between_keys)


def corridor_drive(seed):
    """10 m along two parallel walls, with nothing else within the lidar's 6 m."""
    walls = np.concatenate([polyline([(0, y), (60, y)]) for y in (-1.07, 1.07)])
    world = World.of("bare", walls, [(20.0, 0.0), (30.0, 0.0)])
    lidar = LidarConfig(beams=120, range_max_m=6.0)
    return simulate(world, RobotConfig(), OdometryNoise(), lidar, np.random.default_rng(seed))


def played_bare(play, point_to_line):
    matcher, runs = GaussNewton(point_to_line=point_to_line), []
    slam = GridFastSlam(tracker=Tracker(matcher=matcher), proposal=ScanMatchedProposal(matcher=matcher))
    for log in map(corridor_drive, range(3)):
        reports, odometry = play(slam, log.measurements, particles=PARTICLES)[1], log.odometry.poses
        driven = np.hypot(*(reports[-1].pose - reports[0].pose)[:2])
        runs.append((reports, driven, np.hypot(*(odometry[-1] - odometry[0])[:2])))
    return runs


@pytest.fixture(scope="module")
def bare(play):
    """By `point_to_line`: for each of three bare corridors the reports, and the way driven, beside the odometry's."""
    return {lines: played_bare(play, lines) for lines in (False, True)}


def test_along_a_bare_corridor_the_position_is_undetermined(bare):
    """The axis is a unit vector; the map's x axis is where the robot looked at first."""
    for reports, _, _ in bare[True]:
        keys = [report for report in reports[1:] if not report.skipped]
        axes = [report.degenerate_direction for report in keys if report.degenerate_direction is not None]
        assert len(keys) > 12
        assert len(axes) > 0.85 * len(keys)
        assert all(abs(axis[0]) > 0.99 and np.linalg.norm(axis) == pytest.approx(1.0) for axis in axes)


def test_along_a_bare_corridor_the_covariance_grows_by_the_odometrys(bare):
    """Along the axis as the odometry's error may, across it hardly."""
    for reports, driven, _ in bare[True]:
        sigmas = np.sqrt(reports[-1].covariance.diagonal())
        assert 0.005 * driven < sigmas[0] < 0.1 * driven
        assert sigmas[1] < 0.4 * sigmas[0]
        assert abs(driven - 10.0) < 3 * sigmas[0]
