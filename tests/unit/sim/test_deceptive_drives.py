"""The drives that judge loop closure: some return, some never do, and odometry errs as much as places are apart."""

from __future__ import annotations

import numpy as np
import pytest

from closure_worlds import DECEPTIVE, SEEDS, campus, deceptive, judge, returns
from gridslam import Trajectory
from gridslam.errors import ArgumentError
from gridslam.geometry.se2 import between


@pytest.fixture(scope="module")
def drives():
    """Streams of the forty, not read: the truth and the odometry are known from the start."""
    return {kind: [deceptive(kind, seed).stream() for seed in range(SEEDS)] for kind in DECEPTIVE}


def test_some_return_and_some_never_do(drives):
    shares = {kind: [returns(stream.truth.poses) for stream in of_kind] for kind, of_kind in drives.items()}
    for kind in ("equal_rooms", "bare_corridors"):
        assert shares[kind].count(0.0) >= 3
    for of_kind in shares.values():
        assert sum(share > 0.05 for share in of_kind) >= 4
    assert min(shares["moved_furniture"]) > 0.3


def test_odometry_of_some_of_each_kind_errs_by_as_much_as_alike_places_are_apart(drives):
    """The next equal room or parallel corridor is 2 m to 5 m away; moved furniture, half a metre and more."""
    for kind, least in (("equal_rooms", 3.6), ("symmetric", 3.0), ("bare_corridors", 4.0), ("moved_furniture", 0.9)):
        worst = [np.hypot(*(stream.odometry.poses - stream.truth.poses)[:, :2].T).max() for stream in drives[kind]]
        assert sum(error > least for error in worst) >= 3


@pytest.mark.parametrize("seed", range(3))
def test_the_campus_is_2_km_and_its_odometry_is_lost(seed):
    stream = campus(seed).stream()
    steps = np.diff(stream.truth.poses[:, :2], axis=0)
    assert np.hypot(*steps.T).sum() == pytest.approx(2000, abs=100)
    assert returns(stream.truth.poses) > 0.5
    assert np.hypot(*(stream.odometry.poses - stream.truth.poses)[:, :2].T).max() > 50


def test_a_drive_is_simulated_alike_each_time():
    drive = deceptive("moved_furniture", 1)
    one, again = (next(drive.stream().measurements) for _ in range(2))
    assert one.scan.ranges.tobytes() == again.scan.ranges.tobytes()


def test_returns_by_hand():
    """20 m along a line and back: over the last 5 m, each place was passed 30 m of driving before, or more."""
    x = np.concatenate([np.arange(0, 20, 0.1), np.arange(20, -0.01, -0.1)])
    poses = np.column_stack([x, np.zeros_like(x), np.zeros_like(x)])
    # Within 1 m also counts: places 1 m nearer to the start were passed earlier.
    assert returns(poses, near_m=1.0) == pytest.approx((5 + 0.5) / 40, abs=0.02)
    assert returns(poses[:200]) == 0.0


def test_closures_between_key_scans_are_judged_by_their_stamps():
    poses = np.column_stack([np.arange(10.0), np.zeros(10), np.linspace(-1, 1, 10)])
    truth, keys = Trajectory(100 * np.arange(10), poses), np.array([0, 3, 9])
    measured = between(poses[[0, 3]], poses[[9, 9]])
    measured[1, 0] += 0.6
    verdict = judge(truth, truth.stamps_ns[keys], [[0, 2], [1, 2]], measured)
    assert (verdict.accepted, verdict.false) == (2, 1)
    with pytest.raises(ArgumentError, match="stamps_ns"):
        judge(truth, np.array([0, 150, 901]), [], [])


def test_unknown_kind_is_refused():
    with pytest.raises(ArgumentError, match=r"equal_rooms.*'castle'"):
        deceptive("castle", 0)
