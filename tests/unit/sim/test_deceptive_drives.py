"""The drives that judge loop closure: some return, some never do, and odometry errs as much as places are apart."""

from __future__ import annotations

import numpy as np
import pytest

from closure_worlds import DECEPTIVE, SEEDS, deceptive, returns


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
