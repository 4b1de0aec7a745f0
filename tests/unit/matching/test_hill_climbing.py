"""GMapping's matcher: small moves that score better, and a refusal where nothing scores."""

import numpy as np
import pytest

from gridslam.geometry.angles import wrap
from gridslam.geometry.se2 import compose
from gridslam.matching import HillClimbing
from support.oblong import map_room, scan_at

ROW = np.zeros(1, np.int32)
NO_PRIOR = np.zeros((1, 3, 3))


@pytest.fixture(scope="module")
def room():
    return map_room()


def gmapping_score(maps, pose, beams, matcher):
    """Sum over the beams with an obstacle in the window of exp(-d^2 / scale)."""
    distances = maps.distances(ROW, pose[None], beams.ends)[0].astype(np.float64)
    return np.exp(-(distances[distances <= matcher.kernel_m] ** 2) / matcher.scale_m2).sum()


@pytest.mark.parametrize("seed", range(8))
def test_a_known_displacement_is_found(room, seed):
    """From up to 8 cm and 3 degrees away, to within a fifth of a cell and half a degree."""
    rng = np.random.default_rng(seed)
    truth = rng.uniform(-1, 1, 3) * [1.0, 0.8, np.pi]
    guess = compose(truth, rng.uniform(-1, 1, 3) * [0.08, 0.08, 0.05])
    match = HillClimbing()(room, ROW, guess[None], NO_PRIOR, scan_at(truth))
    np.testing.assert_allclose(match.poses[0, :2], truth[:2], atol=0.02)
    assert abs(wrap(match.poses[0, 2] - truth[2])) < 0.01


@pytest.mark.parametrize("halvings", [0, 2, 5])
def test_no_move_of_the_last_step_scores_better(room, halvings):
    matcher = HillClimbing(halvings=halvings)
    truth, beams = np.array([0.3, -0.2, 0.4]), scan_at(np.array([0.3, -0.2, 0.4]))
    guess = truth + np.array([0.05, -0.06, 0.03])
    found = matcher(room, ROW, guess[None], NO_PRIOR, beams).poses[0]
    best = gmapping_score(room, found, beams, matcher)
    assert best > gmapping_score(room, guess, beams, matcher)
    last = np.array([matcher.step_m, matcher.step_m, matcher.step_rad]) * 0.5**halvings
    for move in np.concatenate([np.diag(last), -np.diag(last)]):
        # found's heading is wrapped after the search, and scores are summed in float32: a few last bits
        assert gmapping_score(room, compose(found, move), beams, matcher) < best + 1e-3
