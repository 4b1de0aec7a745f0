"""Rigid pieces of a trajectory: a blind stretch of way divides it, and a tie that is known joins it again."""

import numpy as np
import pytest

from gridslam.geometry.se2 import between, compose
from gridslam.slam.loop_closure.constraints import Constraint, ConstraintSource
from gridslam.slam.loop_closure.key_graph import (
    BLIND_SIGMA_M,
    BLIND_SIGMA_RAD,
    KEY_SCANS_PER_SUBMAP,
    KeyGraph,
    anchor_of,
)
from gridslam.slam.loop_closure.submaps import key_scans_of

SURE = (0.02**2, 0.01**2)
BLIND = (1.0, 0.3**2)
STEP = np.array([0.5, 0.02, 0.1])


def chain(count, gaps=(), blind=BLIND):
    """A graph of `count` key scans; the robot came blindly to those in `gaps`."""
    graph, tracked = KeyGraph(), np.zeros(3)
    for k in range(count):
        tracked = compose(tracked, STEP) if k else tracked
        graph.extend(tracked, tracked, blind if k in gaps else SURE)
    return graph


def constraint(graph, from_, to, source=ConstraintSource.RECOGNIZED, *, determined=True):
    return Constraint(from_, to, between(graph.tracked[from_], graph.tracked[to]), 1e4 * np.eye(3), source, determined)


def told(graph):
    """The pieces as lists of key scans, in the order of their first ones."""
    labels = graph.label_rigid_components().tolist()
    return [[k for k, label in enumerate(labels) if label == one] for one in dict.fromkeys(labels)]


@pytest.mark.parametrize("at", [1, 17, 20, 39])
def test_a_gap_makes_two_components_and_the_scan_it_leads_to_belongs_to_the_second(at):
    assert told(chain(40, [at])) == [list(range(at)), list(range(at, 40))]


@pytest.mark.parametrize(
    ("variances", "pieces"),
    [
        ((0.99 * BLIND_SIGMA_M**2, 0.99 * BLIND_SIGMA_RAD**2), 1),
        ((1.01 * BLIND_SIGMA_M**2, 0.0), 2),
        ((0.0, 1.01 * BLIND_SIGMA_RAD**2), 2),
    ],
)
def test_a_gap_is_where_the_position_or_the_heading_is_next_to_unknown(variances, pieces):
    assert len(told(chain(20, [9], variances))) == pieces


@pytest.mark.parametrize("source", ConstraintSource)
@pytest.mark.parametrize("determined", [True, False])
def test_only_a_constraint_that_is_known_and_determined_joins_two_components(source, determined):
    graph = chain(40, [20])
    graph.add(constraint(graph, 5, 33, source, determined=determined))
    joined = determined and source is not ConstraintSource.PROXIMITY
    assert len(told(graph)) == (1 if joined else 2)


def test_components_are_joined_through_others_in_whatever_order_the_constraints_came():
    """0-9, 10-19, 20-29, 30-39, 40-49: the last to the second, that to the fourth; the third to the first."""
    ends = [(15, 45), (12, 33), (5, 22), (18, 39)]
    whole = [[*range(10), *range(20, 30)], [*range(10, 20), *range(30, 50)]]
    for order in ([0, 1, 2, 3], [3, 2, 1, 0], [1, 0, 3, 2]):
        graph = chain(50, [10, 20, 30, 40])
        for i in order:
            graph.add(constraint(graph, *ends[i]))
        assert told(graph) == whole
    graph.add(constraint(graph, 25, 49))
    assert told(graph) == [list(range(50))]


@pytest.mark.parametrize("within", range(1, KEY_SCANS_PER_SUBMAP))
def test_a_submap_ends_at_a_gap_and_keeps_its_anchor(within):
    graph = chain(4 * KEY_SCANS_PER_SUBMAP, [KEY_SCANS_PER_SUBMAP + within])
    keys = key_scans_of(1, graph).tolist()
    anchor = anchor_of(1)
    before = list(range(KEY_SCANS_PER_SUBMAP, KEY_SCANS_PER_SUBMAP + within))
    assert keys == (
        before
        if anchor < KEY_SCANS_PER_SUBMAP + within
        else list(range(KEY_SCANS_PER_SUBMAP + within, 2 * KEY_SCANS_PER_SUBMAP))
    )
    assert anchor in keys
    for submap in (0, 2, 3):
        assert key_scans_of(submap, graph).tolist() == list(
            range(submap * KEY_SCANS_PER_SUBMAP, (submap + 1) * KEY_SCANS_PER_SUBMAP)
        )
