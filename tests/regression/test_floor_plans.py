"""Plans of simulated buildings are as exact as the page on floor plans states, and what makes them worse is noticed."""

from __future__ import annotations

import pytest

from floor_plans import failures, map_building, plan_building, score, summarize


@pytest.fixture(scope="module")
def buildings():
    return [map_building("rooms", 7), map_building("random", 31)]  # of which the benchmark has none


def _summary(buildings, points="scans", worse=""):
    return summarize([score(building, plan_building(building, points, worse)) for building in buildings])


def test_walls_doors_and_rooms_are_where_they_are(buildings):
    summary = _summary(buildings)
    assert not failures(summary)
    assert summary["offset_m"] < 0.01
    assert summary["door_recall"] > 0.9
    assert summary["door_precision"] > 0.9


def test_cells_alone_find_walls_to_a_cell(buildings):
    summary = _summary(buildings, points="cells")
    assert summary["wall_precision"] > 0.9
    assert 0.005 < summary["offset_m"] < 0.03


@pytest.mark.parametrize(("worse", "noticed"), [("noisy", "direction_deg"), ("undivided", "rooms_right")])
def test_what_makes_it_worse_is_noticed(buildings, worse, noticed):
    assert noticed in failures(_summary(buildings, worse=worse))
