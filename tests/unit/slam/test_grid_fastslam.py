"""The trunk: one owner for each state, the same bytes for the same seed, and ordinary things taken as ordinary."""

import gc
import io
from dataclasses import replace

import checks
import numpy as np
import pytest
from checks import BAND_M

from gridslam.errors import ArgumentError, ConsumedStateError
from gridslam.geometry.se2 import between
from gridslam.matching import GaussNewton, HillClimbing
from gridslam.models import DiffusionMotion, OdometryMotion
from gridslam.particles import (
    AlwaysResample,
    Multinomial,
    NeverResample,
    ResamplingWheel,
    Residual,
    Stratified,
    Systematic,
)
from gridslam.slam import (
    GridFastSlam,
    GridFastSlamState,
    ImprovedProposal,
    MotionModelProposal,
    OdometryTracker,
    ScanMatchedProposal,
    Tracker,
)
from gridslam.slam.grid_fastslam.map_limit import MapLimit
from gridslam.types import Odometry

LIVELY = GridFastSlam(when_to_resample=AlwaysResample())
"""Resamples at every key scan, so that 24 s are enough to share, copy and free maps in every way."""


def worst_error(reports, truth):
    """Greatest distance (m) of a pose told at the time from the true one, the whole being aligned."""
    return checks.worst_error(np.array([report.pose for report in reports]), truth.poses)


@pytest.fixture(scope="module")
def usual(drive, play):
    """What the default filter says of the undisturbed drive."""
    return play(GridFastSlam(), drive.measurements)


def test_the_undisturbed_drive_is_near_the_truth(usual, drive):
    assert worst_error(usual[1], drive.truth) < BAND_M


def test_a_consumed_state_raises_whatever_it_is_used_for(drive, play):
    state, _ = play(LIVELY, drive.measurements[:10])
    rng = np.random.default_rng(0)
    later, _ = LIVELY.step(state, *drive.measurements[10], rng)
    for use in (lambda: LIVELY.step(state, *drive.measurements[11], rng), state.snapshot, state.to_arrays, state.take):
        with pytest.raises(ConsumedStateError, match="snapshot"):
            use()
    LIVELY.step(later, *drive.measurements[11], rng)


def test_a_snapshot_keeps_the_state_and_replays_to_the_same_bytes(drive, play, contents):
    rng = np.random.default_rng(3)
    state, _ = play(LIVELY, drive.measurements[:50], rng=rng)
    kept, before, draws = state.snapshot(), contents(state), rng.bit_generator.state
    end, reports = play(LIVELY, drive.measurements[50:], state=state, rng=rng)
    assert contents(kept) == before
    assert contents(end) != before
    rng.bit_generator.state = draws
    again, repeated = play(LIVELY, drive.measurements[50:], state=kept.snapshot(), rng=rng)
    assert contents(again) == contents(end)
    assert [report.pose.tobytes() for report in repeated] == [report.pose.tobytes() for report in reports]
    assert contents(kept) == before


def test_branches_do_not_write_into_each_other(drive, play, contents):
    state, _ = play(LIVELY, drive.measurements[:50])
    twin = state.snapshot()
    alone, _ = play(LIVELY, drive.measurements[50:90], state=state.snapshot(), seed=1)
    expected = contents(alone)
    first, second, rngs = state, twin, [np.random.default_rng(1), np.random.default_rng(2)]
    for odometry, scan in drive.measurements[50:90]:  # in turns, over one arena
        first, _ = LIVELY.step(first, odometry, scan, rngs[0])
        second, _ = LIVELY.step(second, odometry, scan, rngs[1])
    assert contents(first) == expected
    assert contents(second) != expected


@pytest.mark.parametrize("at", [60, 61, 90])
def test_odometry_that_is_reset_does_not_move_the_robot(drive, play, at):
    """Its poses begin anew at 0 in mid log, far from where they were; the trajectory goes on."""
    poses = drive.odometry.poses
    assert np.hypot(*poses[at, :2]) > 1.5
    renewed = [*poses[:at], *between(poses[at], poses[at:])]
    scans = [scan for _, scan in drive.measurements]
    log = [(Odometry.at(scan.stamp_ns, pose), scan) for pose, scan in zip(renewed, scans, strict=True)]
    _, reports = play(GridFastSlam(), log)
    assert worst_error(reports, drive.truth) < BAND_M
    assert not any(report.lost for report in reports)


def test_stamps_that_go_backwards_change_nothing(drive, play, contents, usual):
    """The file's order counts; stamps only bound how far odometry can have come, a second is far within 3 m/s."""
    jitter = np.where(np.arange(len(drive)) % 3 == 1, -500_000_000, 0)
    log = [
        (Odometry.at(odometry.stamp_ns + j, odometry.pose), replace(scan, stamp_ns=scan.stamp_ns + j))
        for j, (odometry, scan) in zip(jitter.tolist(), drive.measurements, strict=True)
    ]
    state, reports = play(GridFastSlam(), log)
    assert (np.diff([report.stamp_ns for report in reports]) < 0).any()
    ours, theirs = contents(state), contents(usual[0])
    of_stamps = {"period_s", "stamps_unreliable", "twist", "sensors.stamp_ns"}
    assert {name for name in ours if ours[name] != theirs[name]} == {f"tracker.{name}" for name in of_stamps}


def test_a_tracker_that_needs_odometry_says_so_at_the_first_scan(drive):
    slam = GridFastSlam(tracker=OdometryTracker())
    (odometry, first), (_, second), *_ = drive.measurements
    with pytest.raises(ArgumentError, match=r"odometry: expected a pose with every scan.* none with the scan at 0 ns"):
        slam.init(None, first)
    with pytest.raises(ArgumentError, match=f"none with the scan at {second.stamp_ns} ns"):
        slam.step(slam.init(odometry, first)[0], None, second, np.random.default_rng(0))


@pytest.mark.parametrize(
    "slam",
    [
        GridFastSlam(proposal=MotionModelProposal()),
        GridFastSlam(proposal=ScanMatchedProposal(matcher=HillClimbing())),
        GridFastSlam(proposal=ImprovedProposal()),
        GridFastSlam(proposal=ScanMatchedProposal(matcher=GaussNewton(max_iterations=3))),
        GridFastSlam(tracker=Tracker(map_scans=5)),
        GridFastSlam(tracker=OdometryTracker(), motion=OdometryMotion()),
        GridFastSlam(tracker=OdometryTracker(), motion=DiffusionMotion(0.05, 0.05), proposal=ImprovedProposal()),
        GridFastSlam(when_to_resample=NeverResample()),
        *(
            GridFastSlam(resampler=r(), when_to_resample=AlwaysResample())
            for r in (Multinomial, Residual, ResamplingWheel)
        ),
        *(GridFastSlam(resampler=r(), when_to_resample=AlwaysResample()) for r in (Stratified, Systematic)),
    ],
    ids=lambda slam: f"{type(slam.tracker).__name__}-{type(slam.proposal).__name__}-{type(slam.resampler).__name__}",
)
def test_every_part_can_be_swapped(drive, play, slam):
    """`MotionModelProposal` needs more particles than 10 to be as good: its worst of 6 seeds is 0.40 m."""
    state, reports = play(slam, drive.measurements, particles=10)
    assert worst_error(reports, drive.truth) < (0.6 if isinstance(slam.proposal, MotionModelProposal) else BAND_M)
    assert state.ancestry.steps == sum(report.skipped is None for report in reports)
    resampled = {report.parents is not None for report in reports[1:] if report.skipped is None}
    if isinstance(slam.when_to_resample, AlwaysResample | NeverResample):
        assert resampled == {isinstance(slam.when_to_resample, AlwaysResample)}


SLAM = GridFastSlam(when_to_resample=AlwaysResample())


def restored(state, slam=SLAM, threads=1):
    """The state written as .npz without pickles and read back."""
    file = io.BytesIO()
    np.savez(file, **state.to_arrays())
    file.seek(0)
    with np.load(file, allow_pickle=False) as arrays:
        return GridFastSlamState.from_arrays(dict(arrays), slam.mapper, threads)


@pytest.fixture
def middle(drive, play):
    return play(SLAM, drive.measurements[:60])[0]


@pytest.mark.parametrize(
    "slam",
    [SLAM, GridFastSlam(proposal=ImprovedProposal()), GridFastSlam(tracker=OdometryTracker())],
    ids=["always", "gaussian", "odometry"],
)
@pytest.mark.parametrize("cut", [1, 47, 60])
def test_a_saved_state_goes_on_to_the_same_bytes(drive, play, contents, slam, cut):
    rng = np.random.default_rng(2)
    state, _ = play(slam, drive.measurements[:cut], rng=rng)
    saved, draws = restored(state, slam), rng.bit_generator.state
    assert contents(saved) == contents(state)
    end, reports = play(slam, drive.measurements[cut:], state=state, rng=rng)
    rng.bit_generator.state = draws
    again, repeated = play(slam, drive.measurements[cut:], state=saved, rng=rng)
    assert contents(again) == contents(end)
    for ours, theirs in zip(repeated, reports, strict=True):
        assert ours.pose.tobytes() == theirs.pose.tobytes()
        assert ours.covariance.tobytes() == theirs.covariance.tobytes()
        assert (ours.lost, ours.best, ours.skipped) == (theirs.lost, theirs.best, theirs.skipped)


def test_whatever_is_missing_is_named(middle):
    arrays = middle.to_arrays()
    for name in arrays:
        with pytest.raises(ArgumentError, match=name.split(".")[-1] if name != "schema" else "none"):
            GridFastSlamState.from_arrays({other: a for other, a in arrays.items() if other != name}, SLAM.mapper)


def test_what_only_a_dead_state_used_is_given_back(drive, play, middle):
    tiles = middle.maps.tiles_used
    kept = middle.snapshot()
    later, _ = play(SLAM, drive.measurements[60:90], state=middle)
    together = later.maps.tiles_used
    copy = later.maps.snapshot()
    alone = restored(later).maps.tiles_used
    assert together > alone
    del kept
    gc.collect()
    assert later.maps.tiles_used == copy.tiles_used == alone
    assert alone < together < alone + tiles + 1


FREE = GridFastSlam(when_to_resample=NeverResample(), map_limit=MapLimit(tiles_per_particle=10_000))
TIGHT = GridFastSlam(when_to_resample=NeverResample(), map_limit=MapLimit(tiles_per_particle=20))


def differing(state):
    """Tiles of all maps that are not the best particle's."""
    every = np.arange(len(state.poses))
    return state.maps.tiles_of(every) - state.maps.tiles_of(np.array([state.best]))


@pytest.fixture(scope="module")
def free(drive, play):
    return play(FREE, drive.measurements)


@pytest.fixture(scope="module")
def tight(drive, play):
    return play(TIGHT, drive.measurements)


def test_maps_that_differ_too_much_become_alike_again(free, tight):
    """One scan of this hall touches some 40 tiles: those that differ since the last count are not bounded."""
    assert differing(tight[0]) < 0.6 * differing(free[0])
    gave_way = [report for report in tight[1] if report.parents is not None]
    assert gave_way
    assert all(report.parents is None for report in free[1])


def test_those_of_most_weight_stay(drive, play):
    state, _ = play(FREE, drive.measurements)
    while state.ancestry.steps % 16:  # tiles are counted at each sixteenth key scan only
        state.ancestry.extend(state.poses)
    count, weights = len(state.poses), state.log_weights
    limit = MapLimit(tiles_per_particle=differing(state) // count - 1)
    parents = limit(state)
    stay = np.unique(parents)
    assert len(parents) == count
    assert len(stay) < count
    assert weights[stay].min() >= np.delete(weights, stay).max()
    state.particles_max = 2 * count  # what those that the belief does not need now leave is the others'
    assert limit(state) is None


class _NotingProposal:
    """The default proposal, which notes how many scans hold the best particle."""

    def __init__(self):
        self.scans = []

    def __call__(self, maps, poses, motion, *rest):
        self.scans.append(motion.scans)
        return ScanMatchedProposal()(maps, poses, motion, *rest)


def test_the_best_particle_is_held_by_the_scans_since_the_last_key_scan(drive, play):
    """Not where one of them fits nowhere: then a prediction is in between, and the key scan's match counts alone."""
    noting = _NotingProposal()
    _, reports = play(GridFastSlam(proposal=noting), drive.measurements[:80])
    keys = np.flatnonzero([report.skipped is None for report in reports])
    assert noting.scans == np.diff(keys).tolist()
    assert max(noting.scans) > 2

    longest = int(np.argmax(np.diff(keys)))
    measurements = list(drive.measurements[:80])
    odometry, scan = measurements[keys[longest] + 1]
    noise = np.random.default_rng(0).uniform(0.5, 9.0, len(scan))
    measurements[keys[longest] + 1] = odometry, replace(scan, ranges=noise)
    blind = _NotingProposal()
    _, reports = play(GridFastSlam(proposal=blind), measurements)
    key = int(np.flatnonzero(keys > keys[longest])[0])
    assert [report.skipped for report in reports[: keys[key]]].count(None) == key
    assert blind.scans[: longest + 1] == [*noting.scans[:longest], 1]
