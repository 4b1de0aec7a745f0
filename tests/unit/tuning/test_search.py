"""The parts of a tuning: the space, halving, CMA-ES, and the importance of parameters."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from gridslam.config import PARAMETERS, Configuration, preset
from gridslam.errors import ArgumentError, ConfigurationError
from gridslam.tuning.evolution import evolve
from gridslam.tuning.halving import REDUCTION, halve, plan_rungs
from gridslam.tuning.search_space import SearchSpace

DEFAULT = Configuration()


def test_all_parameters_with_a_range_are_searched_and_no_others():
    space = SearchSpace.of(DEFAULT)
    assert [one.name for one in space.dimensions] == [name for name, one in PARAMETERS.items() if one.search]
    assert {"particles", "range_min_m", "lost_below"}.isdisjoint(one.name for one in space.dimensions)


def test_point_and_values_are_inverse():
    space = SearchSpace.of(DEFAULT)
    for point in np.random.default_rng(0).random((50, len(space))):
        values = space.values_at(point)
        found = space.point_of(space.apply(DEFAULT, values))
        assert space.values_at(found) == values


def test_corners_are_valid_and_the_default_is_itself():
    space = SearchSpace.of(DEFAULT)
    for corner in (np.zeros(len(space)), np.ones(len(space))):
        space.apply(DEFAULT, space.values_at(corner))
    assert space.apply(DEFAULT, space.values_at(space.point_of(DEFAULT))) == DEFAULT


def test_parameters_of_another_kind_are_left_out():
    of_gmapping = [one.name for one in SearchSpace.of(preset("gmapping")).dimensions]
    assert "beam_sigma_m" not in of_gmapping
    assert "key_scan_m" in of_gmapping
    with pytest.raises(ConfigurationError, match="beam_sigma_m: cannot be tuned; expected one of resolution_m"):
        SearchSpace.of(preset("gmapping"), ["beam_sigma_m"])


@pytest.mark.parametrize("candidates", [1, 2, 3, 8, 9, 27, 30, 100])
def test_rungs_end_with_whole_logs_and_cost_about_the_same(candidates):
    rungs = plan_rungs(candidates)
    assert rungs[0].candidates == candidates
    assert rungs[-1].part == 1.0
    costs = [rung.candidates * rung.part for rung in rungs]
    assert max(costs) <= candidates * rungs[0].part + 1e-9
    for one, other in pairwise(rungs):
        assert other.part == pytest.approx(REDUCTION * one.part)
        assert other.candidates == max(1, candidates // REDUCTION ** (rungs.index(other)))
    with pytest.raises(ArgumentError, match="candidates"):
        plan_rungs(0)
    with pytest.raises(ArgumentError, match="shortest_part"):
        plan_rungs(1, 0.0)


def test_halving_keeps_the_best_and_ranks_failures_last():
    """Where parts rank as whole logs do the best of all survives; nobody is evaluated after it was left."""
    rng = np.random.default_rng(0)
    losses = rng.permutation(27).astype(float)
    losses[losses > 20] = math.inf
    asked = []

    def evaluate(candidates, part):
        asked.append((len(candidates), part))
        return [losses[one] + part for one in candidates]

    found = halve(range(27), plan_rungs(27), evaluate)
    assert found[0][0] == int(np.argmin(losses))
    assert [loss for _, loss in found] == sorted(loss for _, loss in found)
    assert asked == [(27, 1 / 9), (9, 1 / 3), (3, 1.0)]


def test_evolution_finds_the_minimum_of_a_quadratic():
    target = np.array([0.2, 0.7, 0.45, 0.6])
    found = evolve(np.full(4, 0.5), 240, lambda points: np.square(points - target).sum(axis=1).tolist(), seed=0)
    best = min(found, key=lambda one: one.loss)
    assert len(found) == 240
    assert best.loss < 1e-3 * 0.1425  # of the loss at the start
    assert np.abs(best.point - target).max() < 0.02


def test_evolution_is_reproducible_stays_in_the_cube_and_survives_failures():
    def evaluate(points):
        assert ((points >= 0) & (points <= 1)).all()
        return [math.inf if point[0] < 0.3 else float(point[0]) for point in points]

    first, second = (evolve(np.array([0.5, 0.5]), 60, evaluate, seed=3) for _ in range(2))
    assert [one.loss for one in first] == [one.loss for one in second]
    assert 0.3 <= min(one.loss for one in first) < 0.33
    assert [one.loss for one in evolve(np.array([0.5, 0.5]), 60, evaluate, seed=4)] != [one.loss for one in first]
