"""The end of a drive that came back is found where its last metres fit."""

import numpy as np
import pytest

from gridslam.geometry.se2 import between, compose
from gridslam.slam.full_slam.revisits_within_drift import propose_revisits
from gridslam.slam.loop_closure.drift_model import DriftModel
from gridslam.slam.loop_closure.loop_closure import LoopClosure
from gridslam.slam.loop_closure.state import LoopClosureState
from gridslam.slam.loop_closure.submap_pairs import SubmapPairs
from gridslam.slam.loop_closure.submap_recognition import SubmapRecognition
from support import hall

LAP = 95
"""Key scans of a lap in the hall."""


@pytest.fixture(scope="module")
def seen():
    return hall.key_scans(hall.drive(1))


DRIVEN = LAP + 16
"""Key scans; recognition needs the submaps of twice as much way in the second lap."""


def drifted(seen, share=8.0, driven=DRIVEN):
    """Remember a drive whose heading drifts; its variances are those of the drift model, times a number."""
    closure_state, pose = LoopClosureState(), seen.truth[0]
    increments = compose(between(seen.truth[:-1], seen.truth[1:]), np.array([0.0, 0.0, 0.0007]))
    variances = share * np.array(DriftModel().variances(0.4, 0.1))
    for k in range(driven):
        pose = compose(pose, increments[k - 1]) if k else pose
        closure_state.scans.append(seen.beams[k], pose, is_key=True)
        closure_state.graph.extend(pose, pose, tuple(variances.tolist()))
    return closure_state


def proposed(closure_state, searched=0):
    return propose_revisits(closure_state, hall.MAPPER, SubmapPairs(), LoopClosure(), lambda: None, searched)


def test_the_last_metres_of_a_lap_are_found_where_the_first_ones_are(seen):
    closure_state = drifted(seen)
    missed = between(seen.truth[DRIVEN - 1], closure_state.graph.poses[-1])
    assert np.hypot(*missed[:2]) > 0.3
    constraints = proposed(closure_state)
    assert constraints
    assert all(from_ < 20 and to >= LAP - 10 for from_, to, *_ in constraints)
    assert (hall.errors(seen.truth, constraints) < [0.05, 0.01]).all()


@pytest.mark.parametrize("share", [1.0, 40.0])
def test_nothing_is_proposed_where_the_drift_is_small_or_allows_for_other_places(seen, share):
    """A few decimetres off the surfaces are matched without; rooms that look alike are some metres apart."""
    assert proposed(drifted(seen, share)) == []


def test_what_was_searched_before_is_not_proposed(seen):
    assert proposed(drifted(seen), searched=DRIVEN) == []


def test_stretches_that_share_a_map_are_not_searched_for_in_their_own_scans(seen):
    """Nothing nearer along the way than recognition asks for is in the map of any of them."""
    closure_state = drifted(seen)
    way = closure_state.graph.driven_m()
    closure = LoopClosure(recognition=SubmapRecognition(apart_m=6.0, certain_sigma_m=0.02))
    found = propose_revisits(closure_state, hall.MAPPER, SubmapPairs(), closure, lambda: None)
    assert found
    assert all(way[to] - way[from_] >= 6.0 for from_, to, *_ in found)


def test_only_the_last_metres_are_searched_for(seen):
    """Of what came before, recognition has enough way: of most of a second lap, 12 stretches that are 5 m apart."""
    asked = []
    closure_state = drifted(seen, driven=len(seen.truth))
    way = closure_state.graph.driven_m()
    assert way[-1] - way[LAP] > 50.0
    propose_revisits(closure_state, hall.MAPPER, SubmapPairs(), LoopClosure(), lambda: asked.append(1))
    assert 4 <= len(asked) <= 7
