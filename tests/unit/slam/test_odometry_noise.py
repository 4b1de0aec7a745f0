"""What a log tells of its odometry's noise widens the particles' control; odometry told to be useless is not used."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gridslam.geometry.se2 import between, compose, compound_covariance
from gridslam.mapping import OccupancyGridMapping
from gridslam.models import DiffusionMotion
from gridslam.particles import NeverResample
from gridslam.sim import LidarConfig, RobotConfig, make_world, simulate
from gridslam.sim import OdometryNoise as SimulatedNoise
from gridslam.slam import GridFastSlam, MotionModelProposal, OdometryTracker, Tracker
from gridslam.slam.grid_fastslam.odometry_noise import OdometryNoise
from gridslam.slam.grid_fastslam.state import GridFastSlamState
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
