"""Plans of simulated buildings are as exact as the page on floor plans states, and what makes them worse is noticed."""

import pytest

from floor_plans import VARIANTS, failures, map_building, score_variants, summarize


@pytest.fixture(scope="module")
def summaries():
    """Of a building that the benchmark has not, by variant."""
    scores = score_variants(map_building("rooms", 7))
    return {name: summarize([scores[name]]) for name in VARIANTS}


def test_walls_doors_and_rooms_are_where_they_are(summaries):
    summary = summaries["end points"]
    assert not failures(summary)
    assert summary["offset_m"] < 0.01
    assert summary["door_recall"] > 0.9
    assert summary["door_precision"] > 0.9


def test_cells_alone_find_walls_to_a_cell(summaries):
    summary = summaries["cells"]
    assert summary["wall_precision"] > 0.9
    assert 0.005 < summary["offset_m"] < 0.03


@pytest.mark.parametrize(("worse", "noticed"), [("noisy", "doors_within_5_cm"), ("undivided", "rooms_right")])
def test_what_makes_it_worse_is_noticed(summaries, worse, noticed):
    assert noticed in failures(summaries[worse])
