"""What a log tells of its odometry's noise widens the particles' control; odometry told to be useless is not used."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gridslam.geometry.se2 import between, compose, compound_covariance
from gridslam.mapping import OccupancyGridMapping
from gridslam.models import DiffusionMotion
from gridslam.sim import LidarConfig, RobotConfig, make_world, simulate
from gridslam.sim import OdometryNoise as SimulatedNoise
from gridslam.slam import GridFastSlam, OdometryTracker, Tracker
from gridslam.slam.grid_fastslam.odometry_noise import OdometryNoise
from gridslam.types import Odometry

SKEWED = np.array([[4e-4, 1e-4, 2e-5], [1e-4, 2e-4, -1e-5], [2e-5, -1e-5, 9e-4]])
EXACT = DiffusionMotion(0.0, 0.0, 0.0, 0.0)


def told(measurements, covariance):
    """The same log, every reading of whose odometry tells this covariance."""
    return [(Odometry.at(odometry.stamp_ns, odometry.pose, covariance), scan) for odometry, scan in measurements]


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
