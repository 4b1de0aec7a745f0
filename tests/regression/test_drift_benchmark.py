"""The benchmark of the drift model distinguishes a true one from those that claim too little or too much."""

from __future__ import annotations

import math

import numpy as np
import pytest

from drift import Drift, judge
from gridslam.geometry.se2 import compose
from gridslam.slam.loop_closure.drift_model import DriftModel
from gridslam.slam.loop_closure.key_graph import KeyGraph

STEP_M = 1.0


def judged(claimed: float, drives: int) -> list[Drift]:
    """Three laps of 63 m, tracked with the errors of a drift model; the graph claims so many times these."""
    keys, turn = 190, STEP_M / 10
    variances = DriftModel().variances(STEP_M, turn)
    sigmas = np.sqrt([*variances[:1] * 2, variances[1]])
    found = []
    for seed in range(drives):
        rng, graph, truth = np.random.default_rng(seed), KeyGraph(), [np.zeros(3)]
        tracked = np.zeros(3)
        for _ in range(keys):
            graph.extend(tracked, tracked, (claimed**2 * variances[0], claimed**2 * variances[1]))
            increment = np.array([STEP_M, 0.0, turn])
            truth.append(compose(truth[-1], increment))
            tracked = compose(tracked, increment + sigmas * rng.standard_normal(3))
        found.append(judge(graph, np.array(truth[:-1])))
    return found


@pytest.mark.parametrize(
    ("claimed", "drives", "least", "most"), [(1.0, 30, 0.90, 0.99), (0.4, 8, 0.0, 0.75), (3.0, 8, 0.999, 1.0)]
)
def test_a_true_model_has_nine_of_ten_within_two_sigma(claimed, drives, least, most):
    """Loops of a drive share their errors: 30 drives are some 60 independent ones, so that 95 % is known to 3 %."""
    drives = judged(claimed, drives)
    assert all(drive.loops > 30 for drive in drives)
    assert least <= np.mean([drive.position_within for drive in drives]) <= most
    assert least <= np.mean([drive.heading_within for drive in drives]) <= most
    ratio = math.sqrt(np.mean([drive.heading_rms**2 for drive in drives])) * claimed
    assert 0.7 < ratio < 1.4
