"""The newest part of a past, by an earlier answer."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from gridslam.particles.ancestry import Ancestry


@settings(max_examples=60, deadline=None)
@given(st.integers(1, 40), st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.2, 0.7]))
def test_an_earlier_past_and_what_is_new_are_the_past(steps, seed, share):
    rng = np.random.default_rng(seed)
    ancestry = Ancestry.start(rng.normal(size=(4, 3)))
    known = np.zeros((0, 2))
    for step in range(steps):
        particle = int(rng.integers(4))
        first, newest = ancestry.newest_positions(particle, known)
        known = np.concatenate([known[:first], newest])
        assert np.array_equal(known, ancestry.trajectory(particle)[:, :2])
        if step % 17 == 16:  # all of the past is corrected
            ancestry = Ancestry.from_trajectory(ancestry.trajectory(particle) + 1.0, 4)
        if rng.random() < share:
            ancestry.resample(rng.integers(0, 4, 4))
        ancestry.extend(rng.normal(size=(4, 3)))
