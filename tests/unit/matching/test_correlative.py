"""The correlative search: guesses too bad for a descent, and no preference where all is equal."""

from __future__ import annotations

import numpy as np
import pytest

from gridslam.geometry.angles import wrap
from gridslam.grid import TileMaps
from gridslam.matching import Correlative
from support.oblong import map_room, scan_at

ROW = np.zeros(1, np.int32)
NO_PRIOR = np.zeros((1, 3, 3))


@pytest.fixture(scope="module")
def room():
    return map_room()


@pytest.mark.parametrize("seed", range(8))
def test_a_guess_anywhere_in_the_window_is_recovered(room, seed):
    """From 0.35 to 0.5 m and up to 0.5 rad away; the room looks alike only half a turn away."""
    rng = np.random.default_rng(seed)
    truth = rng.uniform(-1, 1, 3) * [1.0, 0.8, np.pi]
    away = np.array([*rng.uniform(0.35, 0.5, 2) * rng.choice([-1, 1], 2), rng.uniform(-0.5, 0.5)])
    match = Correlative()(room, ROW, (truth + away)[None], NO_PRIOR, scan_at(truth))
    np.testing.assert_allclose(match.poses[0, :2], truth[:2], atol=0.01)
    assert abs(wrap(match.poses[0, 2] - truth[2])) < 0.003
    assert match.score[0] > 0.95 * 360


class Stripes(TileMaps):
    """Maps that agree wherever x is one of `peaks`; the refinement leaves poses as they are."""

    resolution_m, reach_cells = 0.05, 10.5

    def __init__(self, peaks):
        self.peaks = np.array(peaks)

    def distances(self, rows, poses, points):
        off = np.abs(poses[:, :1] - self.peaks).min(axis=1)
        return np.repeat(np.where(off < 1e-6, 0.0, 0.5).astype(np.float32)[:, None], len(points), axis=1)

    def match(self, rows, guesses, priors, ends, *settings):
        return guesses, np.zeros((len(guesses), 3, 3)), np.zeros(len(guesses))


@pytest.mark.parametrize(("window", "step"), [(0.5, 0.1), (0.25, 0.1), (0.1, 0.1)])
def test_the_window_is_covered_to_its_edges(window, step):
    """A peak at the edge is found, one well outside is not."""
    search = Correlative(window_m=window, step_m=step)
    for peak, found in ((window, True), (-window, True), (window + 2 * step, False)):
        edge = np.ceil(abs(peak) / step - 1e-9) * step * np.sign(peak)
        match = search(Stripes([edge]), ROW, np.zeros((1, 3)), NO_PRIOR, scan_at(np.zeros(3)))
        assert (abs(match.poses[0, 0] - edge) < 1e-9) == found
