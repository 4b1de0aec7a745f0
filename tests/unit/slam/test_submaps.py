"""Submaps are drawn from what was tracked, whatever the map's poses are, and keeping some changes none of them."""

import numpy as np
import pytest

from gridslam.geometry.se2 import compose
from gridslam.slam.loop_closure.state import LoopClosureState
from gridslam.slam.loop_closure.submaps import SubmapCache
from support import hall

COUNT = 65


@pytest.fixture(scope="module")
def closure_state():
    """65 key scans, tracked in a frame that drifts against that of the map."""
    seen, made = hall.key_scans(hall.drive(0)), LoopClosureState()
    hall.remember(made, seen, hall.tracked(seen.truth, 0.002), until=COUNT)
    return made


def contents(maps):
    return {name: array.tobytes() for name, array in maps.to_arrays().items()}


def test_what_is_kept_changes_nothing(closure_state):
    """Asked for in any order, with room for one or for many, before and after a correction."""
    many, one = SubmapCache(), SubmapCache(most=1)
    order = np.random.default_rng(0).integers(0, 6, 20).tolist()
    graph = closure_state.graph.snapshot()
    once = {submap: contents(SubmapCache()(submap, hall.MAPPER, closure_state.scans, graph)) for submap in range(6)}
    for k, submap in enumerate(order):
        if k == 10:
            graph.correct(compose(np.array([5.0, -3.0, 1.0]), np.array(graph.poses)) * [1.01, 1.0, 1.0])
        for submaps in (many, one):
            assert contents(submaps(submap, hall.MAPPER, closure_state.scans, graph)) == once[submap]
    assert many(order[-1], hall.MAPPER, closure_state.scans, graph) is many(
        order[-1], hall.MAPPER, closure_state.scans, graph
    )


def test_room_is_made_by_dropping_what_was_not_used_for_longest(closure_state):
    submaps = SubmapCache(most=2)
    drawn_first = [submaps(submap, hall.MAPPER, closure_state.scans, closure_state.graph) for submap in (0, 1, 0, 2)]
    again = [submaps(submap, hall.MAPPER, closure_state.scans, closure_state.graph) for submap in (0, 2, 1)]
    assert again[0] is drawn_first[0]
    assert again[1] is drawn_first[3]
    assert again[2] is not drawn_first[1]
