"""First guesses from the measurements alone."""

from __future__ import annotations

import numpy as np
import pytest

from gridslam.geometry.se2 import between
from gridslam.slam.pose_graph.linear import initial_guess
from support.random_graphs import random_graph


@pytest.mark.parametrize("seed", range(5))
def test_without_noise_it_is_the_truth(seed):
    known = random_graph(np.random.default_rng(seed), noise=0.0)
    lost = np.concatenate((known.truth[:1], np.full((len(known.truth) - 1, 3), 1e3)))
    found = initial_guess(known.graph.with_poses(lost))
    np.testing.assert_allclose(between(known.truth, found), 0, atol=1e-9)
    assert (found[0] == known.truth[0]).all()
