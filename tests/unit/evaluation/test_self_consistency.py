"""The self-consistency score: whatever is wrong with a trajectory raises it, and nothing cheap lowers it."""

import math

import numpy as np
import pytest

from gridslam.errors import ArgumentError
from gridslam.evaluation import self_consistency
from gridslam.evaluation.self_consistency import measure_self_consistency, score_drawn_scans
from gridslam.geometry.se2 import compose
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate
from gridslam.types import StoredScan, Trajectory


@pytest.fixture(scope="module")
def drive():
    """A drive that comes back to where it began, every eighth scan."""
    rng = np.random.default_rng(0)
    log = simulate(make_world("loop", rng), RobotConfig(), OdometryNoise(), LidarConfig(), rng)
    scans = [scan for _, scan in log.measurements[::8]]
    return scans, [scan.beams(0.05, 30.0) for scan in scans], log.truth.poses[::8].copy()


def _score(beams, poses):
    return score_drawn_scans(beams, poses).nats_per_beam


def _second_half(poses, motion):
    half = len(poses) // 2
    return np.concatenate([poses[:half], compose(np.array(motion), poses[half:])])


def test_every_fault_scores_worse_than_the_truth(drive):
    _, beams, truth = drive
    rng = np.random.default_rng(1)
    faults = {
        "noise of 2 cm": truth + rng.normal(0, [0.02, 0.02, 0.002], truth.shape),
        "noise of 1 degree": truth + rng.normal(0, [0, 0, 0.017], truth.shape),
        "walls doubled by 5 cm": _second_half(truth, [0.05, 0.05, 0.0]),
        "walls doubled by 1 m": _second_half(truth, [1.0, 1.0, 0.0]),
        "mapped twice, far apart": _second_half(truth, [1000.0, 0.0, 0.0]),
        "half as large": truth * [0.5, 0.5, 1.0],
        "all in one place": truth * [0.0, 0.0, 1.0],
        "not even turned": truth * 0.0,
        "each scan elsewhere": truth + rng.uniform(-100, 100, truth.shape),
    }
    true_score = _score(beams, truth)
    ratios = {name: _score(beams, poses) / true_score for name, poses in faults.items()}
    assert min(ratios.values()) > 1.05, ratios


def test_walls_are_less_sharp_by_noise_and_by_visits_that_are_apart(drive):
    """The laser's noise is 1 cm: exact poses leave that of two beams, and corners that are seen from two sides."""
    _, beams, truth = drive
    rng = np.random.default_rng(1)
    noisy = truth + rng.normal(0, [0.02, 0.02, 0.002], truth.shape)
    sharpness = [
        score_drawn_scans(beams, poses).sharpness_m for poses in (truth, noisy, _second_half(truth, [0.05, 0.05, 0.0]))
    ]
    assert 0.01 < sharpness[0] < 0.02
    assert min(sharpness[1:]) > 1.5 * sharpness[0]


def test_a_rigid_motion_of_all_changes_next_to_nothing(drive):
    """The walls lie otherwise in the grid: less than what noise of 1 cm changes."""
    _, beams, truth = drive
    moved = compose(np.array([12.34, -5.67, 0.8]), truth)
    noise = np.random.default_rng(2).normal(0, 0.01, truth.shape) * [1, 1, 0.1]
    true_score = _score(beams, truth)
    assert abs(_score(beams, moved) - true_score) < _score(beams, truth + noise) - true_score


def test_the_score_is_the_chain_rule_over_scans_in_any_order(drive):
    """-ln p(z_1..n | x) = sum of -ln p(z_k | z_1..k-1, x): each scan is predicted by the map of those before it."""
    _, beams, truth = drive
    order = np.random.default_rng(3).permutation(len(truth))[:12]
    totals = [0.0]
    for last in range(1, len(order) + 1):
        found = score_drawn_scans([beams[k] for k in order[:last]], truth[order[:last]])
        totals.append(found.nats_per_beam * found.beams)
    assert (np.diff(totals) > 0).all()  # each is a probability of what was seen, below 1
    whole = score_drawn_scans([beams[k] for k in sorted(order)], truth[sorted(order)])
    assert whole.nats_per_beam * whole.beams == pytest.approx(totals[-1], rel=1e-12)


def test_a_wall_in_one_cell_is_the_beta_function(monkeypatch):
    """A beam of 1 m along the middle of a row of cells, seen twice: 20 cells missed twice, one hit twice."""
    monkeypatch.setattr(self_consistency, "_PLACES", ((0.025, 0.025, 0.0),))
    beam = StoredScan(np.array([[1.0, 0.0]]), np.zeros(2))
    found = score_drawn_scans([beam, beam], np.zeros((2, 3)))
    hit = math.log(0.05 / 1.05) + math.log(1.05 / 2.05)
    missed = math.log(1.0 / 1.05) + math.log(2.0 / 2.05)
    assert found.nats_per_beam == pytest.approx(-(hit + 20 * missed) / 2, rel=1e-9)


def test_what_cannot_be_scored_is_refused(drive):
    scans, beams, truth = drive
    with pytest.raises(ArgumentError, match="a pose within 1 ms of a scan"):
        measure_self_consistency(Trajectory(np.array([-(10**12)]), np.zeros((1, 3))), scans)
    with pytest.raises(ArgumentError, match="a pose within 1 ms of a scan"):
        measure_self_consistency(Trajectory(np.empty(0, np.int64), np.empty((0, 3))), scans)
    with pytest.raises(ArgumentError, match="one for each scan"):
        _score(beams, truth[1:])
    with pytest.raises(ArgumentError, match="finite"):
        _score(beams, truth * np.nan)
    with pytest.raises(ArgumentError, match="at least one beam"):
        _score([], np.empty((0, 3)))
