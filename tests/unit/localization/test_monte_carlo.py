"""Monte Carlo localization in a simulated flat: tracking, finding, kidnapping, and what holds at every step."""

import math
from dataclasses import replace

import numpy as np
import pytest

from gridslam.errors import ArgumentError, ConsumedStateError
from gridslam.geometry.angles import wrap
from gridslam.localization import KnownMap, LocalizationSkip, MonteCarloConfiguration, MonteCarloLocalization
from gridslam.matching.gauss_newton import GaussNewton
from gridslam.sim import OdometryNoise
from gridslam.types import BeamStatus, LaserScan, Odometry
from support.localization_world import drive, flat_map, kidnapped

SPREAD = np.diag([0.04, 0.04, 0.01])


@pytest.fixture(scope="module")
def known():
    return KnownMap(flat_map())


@pytest.fixture(scope="module")
def log():
    return drive(1, OdometryNoise())


def follow(mcl, measurements, seed, pose=None):
    """All reports, and the last state."""
    rng = np.random.default_rng(seed)
    state, reports = mcl.init() if pose is None else mcl.init_gaussian(pose, SPREAD, rng), []
    for odometry, scan in measurements:
        state, report = mcl.step(state, odometry, scan, rng)
        reports.append(report)
    return reports, state


def errors(reports, truth):
    poses = np.array([report.pose for report in reports])
    return np.hypot(*(poses - truth)[:, :2].T), np.abs(wrap(poses[:, 2] - truth[:, 2]))


def test_tracks_from_a_first_pose(known, log):
    reports, state = follow(MonteCarloLocalization(known), log.measurements, 0, log.truth.poses[0] + [0.2, -0.1, 0.05])
    metres, radians = errors(reports, log.truth.poses)
    assert np.sqrt(np.mean(metres[5:] ** 2)) < 0.05
    assert np.sqrt(np.mean(radians[5:] ** 2)) < 0.03
    assert not any(report.lost for report in reports)
    assert len(state.poses) < 4000


@pytest.mark.parametrize("seed", range(2))
def test_is_found_from_nothing(known, log, seed):
    reports, _ = follow(MonteCarloLocalization(known), log.measurements, seed)
    metres, _ = errors(reports, log.truth.poses)
    found = next(k for k, report in enumerate(reports) if not report.lost)
    way = np.hypot(*np.diff(log.truth.poses[: found + 1, :2], axis=0).T).sum()
    assert way < 4
    assert metres[found:].max() < 0.3
    assert reports[0].injection_ratio == 1
    assert reports[0].lost_probability > 0.9


def test_a_kidnapped_robot_is_missed_and_found(known):
    measurements, truth = kidnapped(drive(2), 50, 90)
    reports, _ = follow(MonteCarloLocalization(known), measurements, 0, truth[0])
    metres, _ = errors(reports, truth)
    assert metres[20:51].max() < 0.3
    assert np.hypot(*(truth[51] - truth[50])[:2]) > 2
    assert any(report.lost for report in reports[51:])
    assert metres[-5:].max() < 0.3
    assert sum(report.injection_ratio > 0 for report in reports[51:]) >= 1


def test_the_same_seed_gives_the_same_bytes_with_any_number_of_threads(log):
    runs = []
    for threads in (1, 2, 5):
        reports, state = follow(MonteCarloLocalization(KnownMap(flat_map(), threads=threads)), log.measurements[:30], 7)
        poses = np.array([report.pose for report in reports])
        runs.append((poses.tobytes(), state.poses.tobytes(), reports[-1].lost_probability))
    assert runs[0] == runs[1] == runs[2]
    other, _ = follow(MonteCarloLocalization(KnownMap(flat_map())), log.measurements[:30], 8)
    assert np.array([r.pose for r in other]).tobytes() != runs[0][0]


def test_resampling_changes_no_expectation(known, log):
    """The mean of what survives is in the mean that of the weighted particles: 200 resamplings of one belief."""
    mcl = MonteCarloLocalization(known)
    _, state = follow(mcl, log.measurements[:12], 0, log.truth.poses[0])
    odometry, scan = log.measurements[14]
    means, reports = [], []
    for seed in range(200):
        after, report = mcl.step(state.snapshot(), odometry, scan, np.random.default_rng(seed))
        if report.parents is not None:
            reports.append(report)
            means.append(after.poses.mean(axis=0) - np.exp(report.log_weights) @ report.poses)
    assert len(means) > 20
    assert all(len(set(report.parents.tolist())) > 1 for report in reports)
    deviation = np.std(means, axis=0) / math.sqrt(len(means))
    assert (np.abs(np.mean(means, axis=0)) < 5 * deviation).all()


def test_weights_are_those_of_the_sensor(known, log):
    """log w = log p(z | x) up to a constant where all were equal, less what it costs to stand on no free cell."""
    mcl = MonteCarloLocalization(known)
    poses = np.concatenate([known.sample_poses(200, np.random.default_rng(0)), [[-3.0, -3.0, 0.0], [0.05, 0.05, 1.0]]])
    odometry, scan = log.measurements[0]
    _, report = mcl.step(mcl.init(poses), odometry, scan, np.random.default_rng(0))
    beams = scan.beams(0.05, 30.0)
    thinned = replace(
        beams,
        indices=beams.indices[np.arange(120) * len(beams) // 120],
        ends=beams.ends[np.arange(120) * len(beams) // 120],
    )
    at = report.poses[: len(poses)]
    expected = known.condition(mcl.configuration.sensor, thinned)(at) + np.where(known.is_free(at), 0, math.log(0.01))
    found = report.log_weights[: len(poses)]
    np.testing.assert_allclose(found - found[0], expected - expected[0], atol=1e-6)


def test_what_is_unknown_does_not_count_as_free(known, log):
    """Half of the particles are put on unknown cells where the scan fits as well: they hardly survive an update."""
    grid = known.grid
    x = np.arange(grid.known.shape[1]) * grid.resolution_m + grid.origin[0]
    pose = log.truth.poses[10]
    unseen = grid.known & (grid.log_odds < 0) & (x > pose[0])  # the map's free space ends where the robot stands
    mcl = MonteCarloLocalization(KnownMap(replace(grid, known=grid.known & ~unseen)))
    poses = np.repeat(pose[None], 400, axis=0)
    poses[:200, 0] -= 0.06
    poses[200:, 0] += 0.06
    _, report = mcl.step(mcl.init(poses), *log.measurements[10], np.random.default_rng(0))
    weights = np.exp(report.log_weights)
    assert weights[200:400].sum() < 0.1 * weights[:200].sum()


def test_scans_that_do_not_update_say_why(known, log):
    mcl, rng = MonteCarloLocalization(known), np.random.default_rng(0)
    odometry, scan = log.measurements[0]
    state, report = mcl.step(mcl.init(), None, scan, rng)
    assert report.skipped is LocalizationSkip.NO_ODOMETRY
    assert report.lost
    blind = LaserScan(scan.stamp_ns, scan.ranges, np.full(len(scan), BeamStatus.NO_RETURN, np.uint8), scan.geometry)
    state, report = mcl.step(state, odometry, blind, rng)
    assert report.skipped is LocalizationSkip.NO_VALID_BEAM
    state, report = mcl.step(state, odometry, scan, rng)
    assert report.skipped is None
    assert report.particles == len(state.poses)
    state, report = mcl.step(state, odometry, scan, rng)
    assert report.skipped is LocalizationSkip.MOVED_TOO_LITTLE
    assert report.poses is None


def test_a_scan_without_a_valid_beam_does_not_say_in_which_order_beams_are_measured(known, log):
    """Where no beam is left there is no inlier ratio: NumPy warned of 0 / 0, and the warning was printed."""
    mcl, rng = MonteCarloLocalization(known), np.random.default_rng(0)
    state = mcl.init_gaussian(log.truth.poses[0], SPREAD, rng)
    first, scan = log.measurements[0]
    state, _ = mcl.step(state, first, scan, rng)
    odometry = Odometry(first.stamp_ns + 100_000_000, first.pose + np.array([0, 0, 0.2]))
    blind = np.full(len(scan), BeamStatus.NO_RETURN, np.uint8)
    times = np.linspace(0, 0.15, len(scan))
    turned = LaserScan(odometry.stamp_ns, scan.ranges, blind, scan.geometry, beam_times_s=times)
    _, report = mcl.step(state, odometry, turned, rng)
    assert report.skipped is LocalizationSkip.NO_VALID_BEAM


def test_between_updates_the_pose_goes_on_by_odometry_and_grows_less_sure(known, log):
    parts = MonteCarloConfiguration(matcher=GaussNewton(max_iterations=0))
    mcl = MonteCarloLocalization(known, parts)
    reports, _ = follow(mcl, drive(1, rate_hz=20.0).measurements[:200], 0, log.truth.poses[0])
    updated = np.array([report.skipped is None for report in reports])
    quiet = np.flatnonzero(updated[:-2] & ~updated[1:-1] & ~updated[2:])
    assert len(quiet) > 5
    for k in quiet.tolist():
        headings = [report.covariance[2, 2] for report in reports[k : k + 3]]
        assert headings[0] < headings[1] < headings[2]
        assert np.linalg.eigvalsh(reports[k + 2].covariance)[0] > 0


MEAN = MonteCarloConfiguration(matcher=GaussNewton(max_iterations=0))
"""Tells the mean of the particles."""


def test_where_the_scan_fits_is_nearer_to_the_truth_than_the_mean_of_the_particles(known):
    """Three drives. What is told is not gone by: the particles are the same to the byte."""
    told, mean = [], []
    for seed in range(1, 4):
        log = drive(seed, OdometryNoise())
        (fitted, state), (plain, twin) = (
            follow(mcl, log.measurements, 0, log.truth.poses[0])
            for mcl in (MonteCarloLocalization(known), MonteCarloLocalization(known, MEAN))
        )
        assert state.poses.tobytes() == twin.poses.tobytes()
        assert [report.lost_probability for report in fitted] == [report.lost_probability for report in plain]
        told.append(np.mean(np.square(errors(fitted, log.truth.poses)), axis=1))
        mean.append(np.mean(np.square(errors(plain, log.truth.poses)), axis=1))
    assert (np.sqrt(np.mean(told, axis=0)) < 0.8 * np.sqrt(np.mean(mean, axis=0))).all()


def test_odometry_that_is_told_late_does_not_turn_the_pose(known):
    """Odometry of 0.2 s before; at 1 rad/s it is 0.2 rad behind where the robot turns, and the mean with it."""
    log = drive(1, rate_hz=5.0)
    before = [log.measurements[0], *log.measurements[:-1]]
    late = [
        now._replace(odometry=Odometry.at(now.scan.stamp_ns, then.odometry.pose))
        for now, then in zip(log.measurements, before, strict=True)
    ]
    (told, _), (mean, _) = (
        follow(mcl, late, 0, log.truth.poses[0])
        for mcl in (MonteCarloLocalization(known), MonteCarloLocalization(known, MEAN))
    )
    told_rad, mean_rad = (np.sqrt(np.mean(errors(r, log.truth.poses)[1] ** 2)) for r in (told, mean))
    assert mean_rad > 0.03
    assert told_rad < 0.5 * mean_rad


def test_states(known, log):
    mcl, rng = MonteCarloLocalization(known), np.random.default_rng(0)
    state = mcl.init()
    kept = state.snapshot()
    mcl.step(state, *log.measurements[0], rng)
    with pytest.raises(ConsumedStateError):
        mcl.step(state, *log.measurements[0], rng)
    with pytest.raises(ConsumedStateError):
        state.snapshot()
    mcl.step(kept, *log.measurements[0], rng)
    for wrong in (np.zeros((3, 2)), np.full((2, 3), np.nan)):
        with pytest.raises(ArgumentError, match="particles"):
            mcl.init(wrong)
    with pytest.raises(ArgumentError, match="covariance"):
        mcl.init_gaussian(np.zeros(3), -np.eye(3), rng)


def test_a_robot_that_stands_stays_lost_until_it_moves(known, log):
    """What is seen from one place may be seen from another one: however often it is looked at."""
    mcl, rng = MonteCarloLocalization(known), np.random.default_rng(3)
    odometry, scan = log.measurements[0]
    state, report = mcl.step(mcl.init(), odometry, scan, rng)
    for k in range(1, 200):
        state, report = mcl.step(state, Odometry.at(k, odometry.pose), scan, rng)
        assert report.lost
        assert report.lost_probability > 0.9
    # 12 m x 8 m, nearly all of it possible: an even spread has 3.5 m by 2.3 m.
    assert math.sqrt(report.covariance[0, 0]) > 3
    assert math.sqrt(report.covariance[1, 1]) > 2
    for measurement in log.measurements[1:40]:
        state, report = mcl.step(state, *measurement, rng)
    assert not report.lost
    assert np.sqrt(np.trace(report.covariance[:2, :2])) < 0.2
