"""What the filter tells of each scan: reasons, weights, parents, covariance, where it is lost, what it cannot see."""

import math
from dataclasses import replace
from itertools import takewhile

import numpy as np
import pytest

from gridslam.geometry.se2 import between, compose, rotate_covariances
from gridslam.matching import GaussNewton
from gridslam.models import DiffusionMotion, GaussianIncrement
from gridslam.particles import AlwaysResample, EffectiveSampleSizeBelow
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, World, make_world, simulate
from gridslam.sim.floor_plan import polyline
from gridslam.slam import GridFastSlam
from gridslam.slam.grid_fastslam.proposals import ScanMatchedProposal
from gridslam.slam.grid_fastslam.report_builder import DRIFT
from gridslam.slam.grid_fastslam.smoothed_pose import SmoothedPose
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
        assert sigmas[1] < 0.5 * sigmas[0]
        assert abs(driven - 10.0) < 3 * sigmas[0]


INCREMENT = np.array([0.5, 0.0, 0.1])


def follow_matches(rng, tracked_sigmas, matched_sigmas, steps=4000):
    """Return true, matched and reported poses (T, 3) of a robot in a circle, with noise of tracking and of matches."""
    motion = DiffusionMotion()
    true, reported = np.zeros(3), SmoothedPose(np.zeros(3))
    rows = []
    for _ in range(steps):
        true = compose(true, INCREMENT)
        control = INCREMENT + tracked_sigmas * rng.standard_normal(3)
        matched = true + matched_sigmas * rng.standard_normal(3)
        reported = reported.follow(control, motion(control), matched)
        rows.append((true, matched, reported.pose))
    return np.array(rows).transpose(1, 0, 2)


def test_steps_err_by_half_of_what_those_of_matches_do_and_nothing_adds_up():
    """With the noise of simulated buildings: 3 mm and 1 mrad of tracking, 7 mm and 2 mrad of matches a key scan."""
    true, matched, reported = follow_matches(
        np.random.default_rng(0), np.array([0.003, 0.003, 0.001]), np.array([0.007, 0.007, 0.002])
    )
    of_matches, of_reports = (
        np.sqrt(np.square(between(poses[:-1], poses[1:]) - between(true[:-1], true[1:])).mean(axis=0))
        for poses in (matched, reported)
    )
    assert (of_reports < 0.55 * of_matches).all()
    away = np.sqrt(np.square(reported - true)[:, :2].sum(axis=1).mean())
    assert away < 0.01  # 4000 tracked steps would be off by metres


def test_gain_is_that_of_the_steady_state():
    """Along a line, without noise of the heading: K of the scalar Riccati equation, by hand."""
    q, r = 0.01**2, 0.08**2
    prior = (q + np.sqrt(q * q + 4 * q * r)) / 2
    ahead = np.array([0.5, 0.0, 0.0])
    motion = GaussianIncrement.from_std(ahead, np.array([0.01, 0.01, 0.0]))
    reported = SmoothedPose(np.zeros(3))
    for step in range(200):
        reported = reported.follow(ahead, motion, np.array([0.5 * (step + 1), 0.0, 0.0]))
    missed = reported.follow(ahead, motion, np.array([0.5 * 201 + 0.01, 0.0, 0.0]))
    assert missed.pose[0] - 0.5 * 201 == pytest.approx(0.01 * prior / (prior + r), rel=1e-6)


@pytest.mark.parametrize("away", [[0.3, 0.0, 0.0], [0.0, -0.3, 0.0], [0.0, 0.0, 0.1]])
def test_where_a_loop_closes_the_matched_pose_is_reported_at_once(away):
    reported = SmoothedPose(np.zeros(3)).follow(INCREMENT, DiffusionMotion()(INCREMENT), INCREMENT)
    matched = compose(compose(reported.pose, INCREMENT), np.array(away))
    after = reported.follow(INCREMENT, DiffusionMotion()(INCREMENT), matched)
    np.testing.assert_array_equal(after.pose, matched)


@pytest.mark.parametrize("side", [1, -1])
def test_headings_wrap(side):
    """Half of what the match misses is corrected, from 1 mrad before the back to 4 mrad beyond it."""
    before = SmoothedPose(np.array([0.0, 0.0, side * (np.pi - 0.001)]), np.diag(np.square([0.08, 0.08, 0.03])))
    after = before.follow(
        np.zeros(3), GaussianIncrement.from_std(np.zeros(3), np.zeros(3)), np.array([0, 0, side * (0.009 - np.pi)])
    )
    assert after.pose[2] == pytest.approx(side * (0.004 - np.pi), abs=1e-9)


def test_a_miss_to_the_side_tells_of_the_heading():
    """Of a robot that has driven half a metre by a heading that is uncertain."""
    before = SmoothedPose(np.zeros(3), np.diag([0.0, 0.0, 0.02**2]))
    ahead = np.array([0.5, 0.0, 0.0])
    after = before.follow(ahead, GaussianIncrement.from_std(ahead, np.zeros(3)), np.array([0.5, 0.01, 0.0]))
    assert after.pose[2] > 1e-5
    assert after.pose[1] == pytest.approx(0.5 * after.pose[2], rel=1e-9)
