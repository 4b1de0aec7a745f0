"""Scans far apart are searched for around the odometry, and after a blind gap nobody is dragged back."""

import math
from dataclasses import replace

import numpy as np
import pytest

from gridslam.geometry.angles import wrap
from gridslam.geometry.se2 import between, compose
from gridslam.geometry.single_pose import as_pose
from gridslam.mapping import OccupancyGridMapping
from gridslam.matching import GaussNewton
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate
from gridslam.slam import Tracker
from gridslam.tracking import search
from gridslam.tracking.prediction import Prediction, predict_by_odometry
from gridslam.tracking.search import OdometrySearch
from support import hall

PERFECT = OdometryNoise(1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
SEARCH = OdometrySearch()
MATCHER = GaussNewton()
NEVER = OdometrySearch(sparse_period_s=1e6, sparse_step=1e6, blind_step=1e6)
"""No scan is far from the one before it: what the tracker does is what it does at full rate."""

NO_GATES = ((12.0, math.inf),)
"""Whatever is found about the prediction does not suffice."""

FAR = np.array([0.1, 0.035])
"""Two cells, and what turns a wall 3 m away by as much: what a match ends within, whatever it began from."""


def start(tracker, measurements):
    odometry, scan = measurements[0]
    return tracker.init(odometry, scan.stamp_ns, scan.beams(0.05, 30.0), OccupancyGridMapping())


def step(tracker, state, odometry, scan):
    return tracker.step(state, odometry, scan.stamp_ns, scan.beams(0.05, 30.0))


def track(tracker, measurements):
    """Poses told, and the state after the last."""
    state = start(tracker, measurements)
    return np.array([state.pose, *(step(tracker, state, *m).pose for m in measurements[1:])]), state


def away(poses, others):
    """Metres and radians (N, 2) between poses."""
    off = between(np.atleast_2d(others), np.atleast_2d(poses))
    return np.column_stack([np.hypot(off[..., 0], off[..., 1]), np.abs(wrap(off[..., 2]))])


def jumping(measurements, at, offset):
    """What the odometry tells from scan `at` on is carried along by an increment that was never driven."""
    poses = [odometry.pose for odometry, _ in measurements]
    increments = between(np.array(poses[:-1]), np.array(poses[1:]))
    told = poses[:at]
    for k in range(at, len(poses)):
        arrived = compose(told[-1], increments[k - 1])
        told.append(compose(arrived, np.array(offset)) if k == at else arrived)
    return [(type(o).at(o.stamp_ns, pose), scan) for pose, (o, scan) in zip(told, measurements, strict=True)]


@pytest.fixture(scope="module")
def whole():
    """Through rooms and corridors, ten scans a second; odometry without error."""
    rng = np.random.default_rng(5)
    return simulate(make_world("demo", rng), RobotConfig(), PERFECT, LidarConfig(beams=120, rate_hz=10.0), rng)


@pytest.fixture(scope="module")
def sparse(whole):
    """60 of them, each 0.5 m or more from the one before: 30 m."""
    keys, poses = [0], whole.truth.poses
    for k, pose in enumerate(poses):
        if math.hypot(*(pose - poses[keys[-1]])[:2]) >= 0.5:
            keys.append(k)
    return [whole.measurements[k] for k in keys[:60]]


@pytest.fixture(scope="module")
def tracked(sparse):
    """Poses of the sparse drive with odometry without error."""
    return track(Tracker(), sparse)[0]


JUMPS = range(15, 54, 2)


def after_jumps(tracker, measurements, offset):
    """Yield each place of a jump, and the poses told of the five scans from it on."""
    state = start(tracker, measurements)
    for at in range(1, JUMPS[-1] + 1):
        if at in JUMPS:
            own = state.snapshot()
            yield at, np.array([step(tracker, own, *m).pose for m in jumping(measurements, at, offset)[at : at + 5]])
        step(tracker, state, *measurements[at])


def worst(tracker, sparse, tracked, offset):
    """Metres and radians (J, 2) by which a jump moves the five scans from it on, for each place that it may be at."""
    told = after_jumps(tracker, sparse, offset)
    return np.array([away(poses, tracked[at : at + 5]).max(axis=0) for at, poses in told])


@pytest.mark.parametrize("offset", [(0.0, 0.4, 0.3), (0.0, 0.0, -0.9)])
def test_a_jump_of_the_odometry_between_scans_far_apart_leaves_no_trace(sparse, tracked, offset):
    """Wherever it is on the drive.

    Without the search the heading is lost somewhere, by nearly all that the odometry erred.
    """
    found, lost = (worst(tracker, sparse, tracked, offset) for tracker in (Tracker(), Tracker(search=NEVER)))
    assert (found < FAR).all()
    assert lost[:, 1].max() > 0.8 * abs(offset[2])
    assert lost[:, 0].max() > 0.5


def overgrown(measurements, ratio, seed=0):
    """Scans of which this ratio of beams ends anywhere before the walls, as in leaves."""
    rng = np.random.default_rng(seed)
    for odometry, scan in measurements:
        shares = np.where(rng.random(len(scan.ranges)) < ratio, rng.uniform(0.3, 0.9, len(scan.ranges)), 1.0)
        yield odometry, replace(scan, ranges=scan.ranges * shares)


def test_the_only_place_that_the_odometry_allows_needs_no_more_beams_than_a_match(sparse):
    """Outdoors fewer than 0.7 agree with what was seen before; a turn that is missed there is lost for good."""
    measurements = list(overgrown(sparse, 0.35))
    steady, _ = track(Tracker(), measurements)
    told = after_jumps(Tracker(), measurements, (0.0, 0.0, 0.3))
    off = [away(poses[-1], steady[at + 4])[0, 1] for at, poses in told]
    assert np.median(off) < FAR[1]
    assert np.mean(np.array(off) < 0.1) > 0.8


def predicted_off(pose, turn):
    """A prediction of odometry half a metre on, wrong by a turn, that claims to be as good as odometry usually is."""
    off = compose(pose, np.array([0.0, 0.0, turn]))
    return Prediction(off, True, 0.8, 0.5, 0.1, sigma_m=0.08, sigma_rad=0.03, beam_sigma_m=0.0016)


@pytest.fixture(scope="module")
def states(sparse):
    """What the tracker knew before each scan of the sparse drive, the scan's beams, and where it was."""
    tracker, known = Tracker(), []
    state = start(tracker, sparse)
    for k, (odometry, scan) in enumerate(sparse[1:], 1):
        before = state.snapshot()
        found = step(tracker, state, odometry, scan)
        if k >= 15:
            known.append((before, scan.beams(0.05, 30.0), found.pose))
    return known


@pytest.mark.parametrize("turn", [-1.4, 1.4])
def test_a_turn_that_was_not_counted_at_all_is_found_all_around_or_nothing_is_said(states, turn, monkeypatch):
    """Where nothing lies within the gates; two of three scans see enough of what is mapped to be found again so.

    A place with which 0.8 of the beams agree is the right one.
    """
    monkeypatch.setattr(search, "_GATES", NO_GATES)
    right = 0
    for state, beams, pose in states:
        found = SEARCH(state, predicted_off(pose, turn), beams, MATCHER)
        if found.lost:
            assert found.inlier_ratio == 0
            np.testing.assert_array_equal(found.pose, predicted_off(pose, turn).pose)
        else:
            assert found.inlier_ratio >= 0.8
            assert (away(found.pose, pose) < FAR).all()
            right += 1
    assert right > 0.66 * len(states)


def test_a_place_that_a_match_reaches_from_within_the_gates_is_none_beyond_them(states, monkeypatch):
    """The widest gate reaches 12 standard deviations, of 5 cm."""
    refine, moved = search._refine, 0
    for state, beams, pose in states:
        predicted = predicted_off(pose, 0.05)
        learned = replace(state.odometry_errors, segments=50.0, variances=np.full(2, 1e-6))
        known = replace(state, odometry_errors=learned)
        reach = SEARCH(known, predicted, beams, MATCHER)
        for slid_m, is_lost in ((0.3, False), (0.7, True)):

            def slide(*arguments, told=predicted.pose, slid_m=slid_m):
                x, y, turn = told
                return refine(*arguments)._replace(pose=(x + slid_m, y, turn))

            monkeypatch.setattr(search, "_refine", slide)
            assert reach.lost or SEARCH(known, predicted, beams, MATCHER).lost is is_lost
            monkeypatch.setattr(search, "_refine", refine)
        moved += not reach.lost
    assert moved > 0.8 * len(states)


@pytest.mark.parametrize(
    ("period_s", "stride", "way", "seconds", "far", "blind"),
    [
        (0.1, 0.1, 0.1, 0.1, False, False),
        (0.1, 0.1, 5.0, 0.1, False, False),  # odometry that jumps: a gap takes time
        (0.1, 0.1, 0.1, 5.0, False, False),  # the robot stood
        (0.1, 0.1, 5.0, 5.0, True, True),
        (0.5, 0.1, 0.1, 0.5, True, False),
        (0.1, 0.5, 0.5, 0.1, True, False),  # stamps may be no measurements
    ],
)
def test_scans_are_far_where_they_come_seldom_or_the_laser_was_blind(
    states, period_s, stride, way, seconds, far, blind
):
    state = replace(states[0][0], period_s=period_s, mean_step=stride)
    told = Prediction(state.pose, True, seconds, way, 0.0, 0.1, 0.03, 0.0016)
    assert SEARCH.is_far_from_last(state, told) is far
    assert SEARCH.had_blind_gap(state, told) is blind


STRETCHED = OdometryNoise(1.03, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@pytest.fixture(scope="module")
def halls():
    """A drive of 0.9 m/s and five scans a second by odometry that tells 3 % too much, and its state at scan 60."""
    lidar = LidarConfig(rate_hz=5.0, range_max_m=8.0)
    log = simulate(hall.hall(0), RobotConfig(v_max_m_s=1.0), STRETCHED, lidar, np.random.default_rng(0))
    state = start(Tracker(), log.measurements)
    for measurement in log.measurements[1:60]:
        step(Tracker(), state, *measurement)
    return log, state


def after_a_gap(halls, scans, tracker):
    """What is told of the first scan after a gap, by odometry where it should be, the state then, and metres off."""
    log, known = halls
    state = known.snapshot()
    odometry, scan = log.measurements[60 + scans]
    ahead = compose(
        known.matched_pose, known.odometry_errors.correct_increment(between(known.matched_odometry, odometry.pose))
    )
    told = step(tracker, state, odometry, scan)
    true = compose(known.matched_pose, between(log.truth.poses[59], log.truth.poses[60 + scans]))
    return told, ahead, state, away(told.pose, true)[0]


@pytest.mark.parametrize("scans", [25, 29, 33, 37, 45])
def test_after_a_blind_gap_the_robot_is_where_the_odometry_has_it(halls, scans):
    """5 m and more in 5 s: nothing that is seen is in the local map.

    The odometry errs by 3 % of the way at most, and what was learned of it by less.
    """
    told, ahead, state, off = after_a_gap(halls, scans, Tracker())
    np.testing.assert_allclose(told.pose, ahead, atol=1e-9)
    way = math.hypot(*(ahead - halls[1].matched_pose)[:2])
    assert off[0] < 0.04 * (way + 3.0)
    assert told.control.variances is not None  # particles are told how little is known
    assert told.control.variances[0] == pytest.approx(state.unmatched.position_m2)


def test_motion_that_no_match_has_measured_is_as_uncertain_as_the_odometry_was_found_to_be(halls):
    log, known = halls
    state = known.snapshot()
    state.odometry_errors.variances = np.array([9.0, 0.5])
    told = step(Tracker(), state, *log.measurements[85])
    assert state.unmatched.position_m2 == 9.0
    assert state.unmatched.heading_rad2 == 0.5
    assert told.control.variances == (9.0, 0.5)  # by which particles are drawn and searched for


def test_a_blind_gap_makes_doubt_by_what_the_odometry_may_err(halls):
    """Whether or not the scan was found: it may have been found where it looks alike.

    15 % of the way and more; beyond two metres errors of calibrated odometry are those of a random walk.
    """
    doubts = []
    for scans in (5, 9, 13, 25, 33, 45):
        _, ahead, state, _ = after_a_gap(halls, scans, Tracker())
        way = math.hypot(*(ahead - halls[1].matched_pose)[:2])
        assert 0.15 * min(way, math.sqrt(2 * way)) < math.sqrt(state.unmatched.position_m2)
        assert state.unmatched.heading_rad2 > 0
        doubts.append(state.unmatched.position_m2)
    assert halls[1].unmatched.position_m2 == 0
    assert doubts[:3] == sorted(doubts[:3])


def test_errors_of_calibrated_odometry_are_a_random_walk_beyond_two_metres(halls):
    """Those of odometry that is not may be systematic, and add up."""
    for segments, far in ((50.0, 2.0), (5.0, 4.0)):
        state = replace(halls[1], odometry_errors=replace(halls[1].odometry_errors, segments=segments))
        sigmas = []
        for way in (0.0, 2.0, 8.0):
            reading = compose(state.odometry, np.array([way, 0.0, 0.0]))
            told = predict_by_odometry(state, state.pose, state.odometry, as_pose(reading), 1.0, 0.0016)
            sigmas.append([told.sigma_m, told.sigma_rad])
        grown = np.diff(np.array(sigmas), axis=0).cumsum(axis=0)
        np.testing.assert_allclose(grown[1] / grown[0], far, rtol=0.05)


def test_after_a_blind_gap_a_place_beyond_twice_the_odometrys_error_is_not_believed(states):
    """Ten standard deviations off: between scans far apart it is found, after a gap many places look alike."""
    found = [0, 0]
    for state, beams, pose in states:
        predicted = predicted_off(pose, 0.5)._replace(seconds=5.0, moved_m=5.0)
        for is_blind in (True, False):
            known = replace(state, period_s=0.1, mean_step=0.1) if is_blind else state
            place = SEARCH(known, predicted, beams, MATCHER)
            found[is_blind] += not place.lost and (away(place.pose, pose) < FAR).all()
    assert found[True] == 0
    assert found[False] > 0.5 * len(states)


def test_a_place_far_from_the_odometry_must_be_certain_where_scans_come_seldom_but_near_each_other(sparse, states):
    """Sixteen standard deviations off, with fewer beams than 0.7: scans far from each other share no more.

    A robot that drives through a door slowly sees little that is mapped, and elsewhere half of it fits.
    """
    believed = {0.2: [], 0.5: []}
    scans = list(overgrown(sparse, 0.35))[15:]
    for (state, *_, pose), (_, scan) in zip(states, scans, strict=True):
        for step_m, ratios in believed.items():
            known = replace(state, period_s=0.6, mean_step=step_m)
            place = SEARCH(known, predicted_off(pose, 0.5), scan.beams(0.05, 30.0), MATCHER)
            ratios.append(place.inlier_ratio)
    assert not any(0 < ratio < 0.7 for ratio in believed[0.2])
    assert np.mean([0 < ratio < 0.7 for ratio in believed[0.5]]) > 0.3
