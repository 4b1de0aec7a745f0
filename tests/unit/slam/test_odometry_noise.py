"""What a log tells of its odometry's noise widens the particles' control; odometry told to be useless is not used."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gridslam.geometry.se2 import between, compose, compound_covariance
from gridslam.mapping import OccupancyGridMapping
from gridslam.models import DiffusionMotion, GaussianIncrement
from gridslam.particles import NeverResample
from gridslam.sim import LidarConfig, RobotConfig, make_world, simulate
from gridslam.sim import OdometryNoise as SimulatedNoise
from gridslam.slam import GridFastSlam, MotionModelProposal, OdometryTracker, Tracker
from gridslam.slam.grid_fastslam.odometry_noise import OdometryNoise, is_worse_than_velocity
from gridslam.slam.grid_fastslam.state import GridFastSlamState
from gridslam.tracking.prediction import ConstantVelocity
from gridslam.types import Odometry

SKEWED = np.array([[4e-4, 1e-4, 2e-5], [1e-4, 2e-4, -1e-5], [2e-5, -1e-5, 9e-4]])
EXACT = DiffusionMotion(0.0, 0.0, 0.0, 0.0)
FILTER = GridFastSlam(particles=200, motion=EXACT, proposal=MotionModelProposal(), when_to_resample=NeverResample())
"""Its particles spread by what the log tells and by nothing else, and keep where they were drawn."""


def told(measurements, covariance):
    """The same log, every reading of whose odometry tells this covariance."""
    return [(Odometry.at(odometry.stamp_ns, odometry.pose, covariance), scan) for odometry, scan in measurements]


def played(slam, measurements, seed=0):
    """State and reports of a filter."""
    rng, state, reports = np.random.default_rng(seed), None, []
    for odometry, scan in measurements:
        state, report = slam.step(state, odometry, scan, rng) if state else slam.init(odometry, scan)
        reports.append(report)
    return state, reports


def to_second_key_scan(slam, measurements):
    """The particles at the first key scan after the beginning."""
    rng, (state, report) = np.random.default_rng(0), slam.init(*measurements[0])
    for odometry, scan in measurements[1:]:
        state, report = slam.step(state, odometry, scan, rng)
        if report.skipped is None:
            return report
    raise AssertionError("no key scan")


def spread(report):
    """Standard deviations of the particles' positions (m) and headings (rad)."""
    deviations = report.poses - report.poses[0]
    return np.hypot(*deviations[:, :2].std(axis=0)), deviations[:, 2].std()


def test_an_increment_may_have_any_covariance():
    sampler = GaussianIncrement.with_covariance(np.array([0.5, -0.1, 0.3]), SKEWED)
    pose = np.array([[1.0, 2.0, 0.0]])
    means, covariances = sampler.moments(pose)
    np.testing.assert_allclose(means, compose(pose, [0.5, -0.1, 0.3]))
    np.testing.assert_allclose(covariances[0], SKEWED, atol=1e-12)
    drawn = sampler(np.repeat(pose, 100_000, axis=0), np.random.default_rng(0)) - means
    # the deviation of a variance's estimate is sqrt(2 / n) of it, 0.5 %; five of them
    np.testing.assert_allclose(np.cov(drawn.T), SKEWED, atol=0.025 * 9e-4)


def test_noise_of_increments_is_compounded_as_draws_of_them_are(drive):
    """From one key scan to the next by odometry alone, against increments drawn one after the other."""
    slam = GridFastSlam(particles=1, tracker=OdometryTracker(), motion=EXACT)
    measurements = told(drive.measurements[:40], SKEWED)
    state, _ = slam.init(*measurements[0])
    rng, count = np.random.default_rng(0), 20_000
    drawn, roots = np.zeros((count, 3)), np.linalg.cholesky(SKEWED)
    for k in range(1, len(measurements)):
        before, now = measurements[k - 1][0].pose, measurements[k][0].pose
        noise = rng.standard_normal((count, 3)) @ roots.T
        drawn = compose(drawn, between(before, now) + noise)
        state, report = slam.step(state, *measurements[k], rng)
        if report.skipped is None:
            break
        expected = state.odometry_covariance
        assert expected is not None
    noise = OdometryNoise.from_reading(state, measurements[k + 1][0], matched=False)
    np.testing.assert_allclose(noise.covariance, SKEWED, rtol=1e-9)  # begins anew at the key scan
    # Linear in noise of 1 to 7 degrees: a few percent; 20000 draws: one percent.
    moved = between(np.zeros(3), drawn)
    assert k > 3
    found, scale = np.cov((moved - moved.mean(axis=0)).T), np.sqrt(np.diagonal(expected))
    grown = k / (k - 1)  # the key scan's own increment is in the draws, too
    np.testing.assert_allclose(np.sqrt(np.diagonal(found)), np.sqrt(grown) * scale, rtol=0.15)


def test_the_less_certain_the_odometry_the_wider_the_particles(drive):
    """Of a tracker that takes the odometry as it is; one that matches scans knows better."""
    slam, measurements = replace(FILTER, tracker=OdometryTracker()), drive.measurements[:40]
    spreads = [
        spread(to_second_key_scan(slam, told(measurements, np.diag([v, v, 4 * v])))) for v in (1e-8, 1e-6, 1e-5, 1e-4)
    ]
    assert (np.diff(spreads, axis=0) > 0).all()
    assert max(spread(to_second_key_scan(slam, measurements))) == 0
    one = spread(to_second_key_scan(slam, told(measurements, np.diag([1e-6, 1e-6, 4e-6]))))
    # at least that of one reading, the position's in two directions
    assert one[0] > 0.8 * np.sqrt(2e-6)
    assert one[1] > 0.8 * 2e-3


def test_it_adds_to_the_motion_models_noise(drive):
    measurements = drive.measurements[:40]
    slam = replace(FILTER, motion=DiffusionMotion(), tracker=OdometryTracker())
    alone, both = (to_second_key_scan(slam, log) for log in (measurements, told(measurements, np.diag([1e-4] * 3))))
    assert spread(both)[0] > spread(alone)[0]
    assert spread(both)[1] > spread(alone)[1]


def test_useless_odometry_is_not_used(drive):
    """Told to be uncertain by 10 m and 10 rad it is as if there were none, and the map is as good as without."""
    useless, without = (
        played(GridFastSlam(particles=3), log)[1]
        for log in (told(drive.measurements, 100 * np.eye(3)), [(None, scan) for _, scan in drive.measurements])
    )
    usual = played(GridFastSlam(particles=3), drive.measurements)[1]
    assert not np.array_equal([r.pose for r in useless], [r.pose for r in usual])
    missed = between(drive.truth.poses[0], drive.truth.poses) - [report.pose for report in useless]
    assert np.hypot(*missed[:, :2].T).max() < 0.2
    # all but the first scan, which takes note of its odometry
    assert np.allclose([r.pose for r in useless], [r.pose for r in without], atol=0.05)


def test_without_covariance_nothing_is_different(drive):
    measurements = [(Odometry(odometry.stamp_ns, odometry.pose), scan) for odometry, scan in drive.measurements[:30]]
    state, _ = played(GridFastSlam(particles=3), measurements)
    assert state.odometry_covariance is None
    assert "odometry_covariance" not in state.to_arrays()


def test_where_one_reading_tells_none_nothing_is_known_until_the_odometry_begins_anew(drive):
    slam = GridFastSlam(particles=1, tracker=OdometryTracker())
    measurements = told(drive.measurements[:4], SKEWED)
    measurements[2] = drive.measurements[2]
    state, _ = slam.init(*measurements[0])
    known = []
    for odometry, scan in measurements[1:]:
        state, report = slam.step(state, odometry, scan, np.random.default_rng(0))
        assert report.skipped is not None
        known.append(state.odometry_covariance is not None)
    assert known == [True, False, False]


def test_a_state_goes_on_to_the_same_bytes(drive):
    slam, measurements = replace(FILTER, particles=5), told(drive.measurements[:40], SKEWED / 100)
    state, _ = played(slam, measurements[:13])
    again = GridFastSlamState.from_arrays(state.to_arrays(), slam.mapper)
    for one in (state, again):
        assert np.array_equal(one.odometry_covariance, state.odometry_covariance)
    ends = []
    for one in (state.snapshot(), again):
        rng = np.random.default_rng(1)
        for odometry, scan in measurements[13:]:
            one, report = slam.step(one, odometry, scan, rng)
        ends.append((one.poses, report.pose))
    assert np.array_equal(ends[0][0], ends[1][0])
    assert np.array_equal(ends[0][1], ends[1][1])


def test_velocity_is_better_where_either_is_told_to_be_worse():
    velocity = ConstantVelocity()
    sigma_m, sigma_rad = velocity.sigmas(0.2)
    for share, worse in ((0.9, False), (1.1, True)):
        for scaled in (np.diag([(share * sigma_m) ** 2, 1e-8, 1e-8]), np.diag([1e-8, 1e-8, (share * sigma_rad) ** 2])):
            assert is_worse_than_velocity(Odometry.at(0, np.zeros(3), scaled), 0.2, velocity) is worse
    assert not is_worse_than_velocity(Odometry.at(0, np.zeros(3)), 0.2, velocity)


def tracked(log, covariances):
    """Poses (N, 3) that the tracker alone finds, by odometry of increments with these covariances."""
    scans = [scan.beams(0.05, 30.0) for _, scan in log.measurements]
    tracker = Tracker()
    state = tracker.init(log.measurements[0].odometry, scans[0].scan.stamp_ns, scans[0], OccupancyGridMapping())
    poses = [state.pose]
    since = None
    for (odometry, scan), beams, covariance in zip(log.measurements[1:], scans[1:], covariances, strict=True):
        if covariance is not None:  # compounded since the last scan that was matched
            moved = between(state.matched_odometry, state.odometry)
            before = np.zeros((3, 3)) if since is None or np.array_equal(moved, np.zeros(3)) else since
            since = compound_covariance(moved, before, between(state.odometry, odometry.pose), covariance)
        poses.append(tracker.step(state, odometry, scan.stamp_ns, beams, since).pose)
    return np.array(poses)


def test_the_tracker_weighs_odometry_by_the_covariance_that_is_reported(drive):
    """Odometry that is off by 4 cm and 0.02 rad holds a match near it, and one 100 times less certain does not."""
    tracker = Tracker(standstill_m=0.0, standstill_rad=0.0)
    scans = [scan.beams(0.05, 30.0) for _, scan in drive.measurements[:31]]
    state = tracker.init(drive.measurements[0].odometry, scans[0].scan.stamp_ns, scans[0], OccupancyGridMapping())
    for (odometry, scan), beams in zip(drive.measurements[1:30], scans[1:30], strict=True):
        tracker.step(state, odometry, scan.stamp_ns, beams)
    odometry = drive.measurements[30].odometry
    wrong = Odometry.at(odometry.stamp_ns, compose(odometry.pose, [0.03, -0.03, 0.02]))
    away = []
    for variance in (1e-8, 1e-6):
        found = tracker.step(state.snapshot(), wrong, odometry.stamp_ns, scans[30], variance * np.eye(3))
        off = between(found.predicted, found.pose)
        away.append((np.hypot(off[0], off[1]), abs(off[2])))
    certain, uncertain = np.array(away)
    assert (certain < 0.8 * uncertain).all()
    assert certain[0] < 0.01 < 0.03 < uncertain[0]


def test_a_valid_covariance_of_the_odometry_makes_the_tracker_better():
    """Ten drives whose odometry has noise of known covariance: the error of the motion over ten scans, in the mean."""
    alpha = 2e-4
    errors = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        noise = SimulatedNoise(1.0, 1.0, 0.0, alpha, alpha, alpha, alpha)
        log = simulate(make_world("rooms", rng), RobotConfig(), noise, LidarConfig(beams=120, rate_hz=5.0), rng)
        log = replace(log, measurements=log.measurements[:120])
        increments = between(log.odometry.poses[:119], log.odometry.poses[1:120])
        variances = alpha * (np.hypot(increments[:, 0], increments[:, 1]) + np.abs(increments[:, 2])) + 1e-8
        covariances = [np.diag([variance, 1e-8, variance]) for variance in variances]
        true = between(log.truth.poses[:110], log.truth.poses[10:120])
        errors.append([])
        for known in (covariances, [None] * 119):
            poses = tracked(log, known)
            off = between(true, between(poses[:-10], poses[10:]))
            errors[-1].append((np.hypot(off[:, 0], off[:, 1]).mean(), np.abs(off[:, 2]).mean()))
    with_covariance, without = np.mean(errors, axis=0)
    assert (with_covariance < without).all()
