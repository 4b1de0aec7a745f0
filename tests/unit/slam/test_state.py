"""The state as plain arrays, and what it costs to keep one."""

from __future__ import annotations

import gc
import io

import numpy as np
import pytest

from gridslam.errors import ArgumentError, ConsumedStateError
from gridslam.particles import AlwaysResample
from gridslam.slam import STATE_SCHEMA, GridFastSlam, GridFastSlamState, ImprovedProposal, OdometryTracker

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


def test_the_arrays_are_a_copy(drive, contents, middle):
    before = contents(middle)
    arrays = middle.to_arrays()
    again = GridFastSlamState.from_arrays(arrays, SLAM.mapper)
    SLAM.step(again, *drive.measurements[60], np.random.default_rng(0))
    assert {name: (str(a.dtype), a.shape, a.tobytes()) for name, a in arrays.items()} == before
    assert contents(middle) == before


def test_the_schema_is_plain(middle):
    arrays = middle.to_arrays()
    assert str(arrays["schema"]) == STATE_SCHEMA
    assert all(array.dtype.kind in "iufbU" for array in arrays.values())


@pytest.mark.parametrize("schema", ["gridslam.state/1", "gridslam.state/2", ""])
def test_another_schema_raises(middle, schema):
    arrays = middle.to_arrays() | {"schema": np.array(schema)}
    with pytest.raises(ArgumentError, match=STATE_SCHEMA):
        GridFastSlamState.from_arrays(arrays, SLAM.mapper)


def test_whatever_is_missing_is_named(middle):
    arrays = middle.to_arrays()
    for name in arrays:
        with pytest.raises(ArgumentError, match=name.split(".")[-1] if name != "schema" else "none"):
            GridFastSlamState.from_arrays({other: a for other, a in arrays.items() if other != name}, SLAM.mapper)


def test_a_consumed_state_cannot_be_saved(drive, middle):
    SLAM.step(middle, *drive.measurements[60], np.random.default_rng(0))
    with pytest.raises(ConsumedStateError):
        middle.to_arrays()


def test_a_snapshot_costs_its_tables_alone(middle):
    """No tile is copied for it, and one is copied only when either side writes into it."""
    tiles, held = middle.maps.tiles_used, middle.maps._arena.nbytes
    kept = [middle.snapshot() for _ in range(20)]
    assert middle.maps.tiles_used == tiles
    assert middle.maps._arena.nbytes == held
    for state in kept:
        assert state.maps._arena is middle.maps._arena
        assert not np.shares_memory(state.maps._roots, middle.maps._roots)
        assert state.maps._roots.nbytes < 0.01 * held
        assert np.shares_memory(state.poses, middle.poses)


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


def test_states_that_are_thrown_away_leave_nothing(drive, play, middle):
    """Branching ten times off one state holds no more tiles than one branch does."""
    before, most = middle.maps.tiles_used, 0
    for seed in range(10):
        branch, _ = play(SLAM, drive.measurements[60:70], state=middle.snapshot(), seed=seed)
        most = max(most, branch.maps.tiles_used)
        del branch
        gc.collect()
        assert middle.maps.tiles_used == before
    assert before < most < 3 * before


def test_no_tile_is_lost_over_a_run(drive, play):
    """What the arena counts as used is what the living particles' maps reach, and nothing else."""
    state, _ = play(SLAM, drive.measurements)
    arrays = state.maps.to_arrays()
    assert state.maps.tiles_used == len(arrays["log_odds"]) - 1
    assert state.tracker.maps.tiles_used == len(state.tracker.maps.to_arrays()["log_odds"]) - 1


def test_particles_share_what_they_have_in_common(drive, play):
    """Thirty particles cost their own tiles; thirty that continue one of them cost that one's, until they write."""
    state = play(SLAM, drive.measurements, particles=30)[0]
    different = state.maps.tiles_used
    state.resample(np.zeros(30, np.int64))
    assert 0 < state.maps.tiles_used < different / 20
