"""Tours take every passage about equally often; a robot that wanders stays close to its way."""

from itertools import pairwise

import numpy as np
import pytest

from gridslam.sim.floor_plan import clearance, polyline
from gridslam.sim.world import wander
from passages import tour

JUNCTIONS = np.array([(0, 0), (10, 0), (20, 0), (20, 8), (10, 8), (30, 0)], dtype=float)
PASSAGES = [(0, 1), (1, 2), (2, 3), (3, 4), (4, 1), (2, 5)]


@pytest.mark.parametrize("seed", range(5))
def test_tour_follows_passages_and_turns_back_only_in_dead_ends(seed):
    route = tour(JUNCTIONS, PASSAGES, 600.0, np.random.default_rng(seed))
    places = [int(np.flatnonzero((point == JUNCTIONS).all(axis=1))[0]) for point in route]
    ends = [frozenset(pair) for pair in pairwise(places)]
    assert ends[0] == {0, 1}
    assert set(ends) == {frozenset(pair) for pair in PASSAGES}
    assert all(place in (0, 5) for place, (a, b) in zip(places[1:-1], pairwise(ends), strict=True) if a == b)
    assert 600 <= np.hypot(*np.diff(route, axis=0).T).sum() < 610 + 8
    counts = [ends.count(frozenset(pair)) for pair in PASSAGES]
    assert max(counts) <= 2 * min(counts)


def test_wandering_keeps_the_waypoints_and_stays_near_the_line():
    line = np.array([(0, 0), (40, 0), (40, 3), (0, 3)], dtype=float)
    route, places = wander(line, np.random.default_rng(1), aside_m=0.2, every_m=5.0)
    assert np.array_equal(route[places], line)
    assert np.diff(places).tolist() == [8, 1, 8]
    away = clearance(polyline(line), route)
    assert 0.1 < away.max() <= 0.2
    assert np.hypot(*np.diff(route, axis=0).T).min() > 2.9
