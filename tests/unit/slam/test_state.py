"""The state as plain arrays, and what it costs to keep one."""

import gc
import io

import numpy as np
import pytest

from gridslam.errors import ArgumentError
from gridslam.particles import AlwaysResample
from gridslam.slam import GridFastSlam, GridFastSlamState, ImprovedProposal, OdometryTracker

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
