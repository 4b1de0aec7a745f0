"""Few particles stand for many: fairly, without chance, and all of them where they are few."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from gridslam.viz.cloud import select_representatives


@given(st.integers(1, 300), st.integers(1, 100), st.integers(0, 2**32 - 1), st.floats(0.0, 8.0))
def test_any_part_of_a_cloud_keeps_its_weight(count, most, seed, spread):
    """Of a run of particles one after the other the share is told to within 1 / `most`."""
    rng = np.random.default_rng(seed)
    weights = np.exp(spread * rng.normal(size=count))
    weights /= weights.sum()
    chosen, shares = select_representatives(weights, most)
    assert len(chosen) <= min(most, count)
    assert (np.diff(chosen) > 0).all()
    told = np.zeros(count)
    told[chosen] = shares
    assert abs(told.sum() - 1) < 1e-9
    apart = np.cumsum(told) - np.cumsum(weights)
    assert apart.max() - apart.min() <= 1 / most + 1e-9


def test_few_particles_are_all_shown_as_they_are():
    weights = np.array([0.9, 0.1, 0.0])
    chosen, shares = select_representatives(weights, 3)
    np.testing.assert_array_equal(chosen, [0, 1, 2])
    np.testing.assert_array_equal(shares, weights)
    assert len(select_representatives(np.zeros(0))[0]) == 0
