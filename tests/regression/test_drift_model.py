"""Errors of tracked motion around loops, in the standard deviations that a drift model claims."""

from __future__ import annotations

import numpy as np
import pytest

from gridslam.geometry.se2 import between, compose
from gridslam.slam.loop_closure.drift_model import DriftModel
from gridslam.slam.loop_closure.key_graph import KeyGraph, position_sigmas
from gridslam.slam.loop_closure.submap_recognition import locate_anchors

STEP_M = 1.0


def loop_errors(claimed, seed):
    """Ratios (N, 2) of position and heading errors to their standard deviations in one drive of three laps of 63 m.

    It is tracked with the errors of the drift model; the graph claims `claimed` times these.
    """
    turn = STEP_M / 10
    variances = DriftModel().variances(STEP_M, turn)
    sigmas = np.sqrt([*variances[:1] * 2, variances[1]])
    rng, graph = np.random.default_rng(seed), KeyGraph()
    tracked, truth = [np.zeros(3)], [np.zeros(3)]
    for _ in range(190):
        graph.extend(tracked[-1], tracked[-1], (claimed**2 * variances[0], claimed**2 * variances[1]))
        increment = np.array([STEP_M, 0.0, turn])
        truth.append(compose(truth[-1], increment))
        tracked.append(compose(tracked[-1], increment + sigmas * rng.standard_normal(3)))
    way, poses, drifted = graph.driven_m(), np.array(truth), np.array(tracked)
    ratios = []
    for key in range(190):
        older = np.flatnonzero(way[key] - way > 40.0)
        older = older[np.hypot(*(poses[older] - poses[key])[:, :2].T) < 8.0]
        if len(older):
            expected, covariances = locate_anchors(graph, older, key)
            true = between(poses[older], poses[key])
            turned = compose(drifted[older], true) - compose(drifted[older], expected)
            position = np.hypot(turned[:, 0], turned[:, 1]) / position_sigmas(covariances)
            heading = np.abs(between(expected, true)[:, 2]) / np.sqrt(covariances[:, 2, 2])
            ratios.append(np.column_stack([position, heading]))
    return np.concatenate(ratios)


@pytest.mark.parametrize(
    ("claimed", "drives", "least", "most"), [(1.0, 50, 0.90, 0.99), (0.4, 15, 0.0, 0.75), (3.0, 15, 0.999, 1.0)]
)
def test_a_true_model_has_nine_of_ten_within_two_sigma(claimed, drives, least, most):
    """Loops of a drive share their errors: 50 drives are some 100 independent ones, so that 95 % is known to 2 %."""
    errors = [loop_errors(claimed, seed) for seed in range(drives)]
    within = np.mean([(ratios < 2).mean(axis=0) for ratios in errors], axis=0)
    assert ((least <= within) & (within <= most)).all()
    heading_rms = np.sqrt(np.mean([np.square(ratios[:, 1]).mean() for ratios in errors]))
    assert 0.7 < heading_rms * claimed < 1.4
