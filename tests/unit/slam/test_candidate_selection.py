"""A trajectory that recognized places change is compared with what they make of it."""

import numpy as np
import pytest

from gridslam.geometry.se2 import between, compose
from gridslam.mapping import OccupancyGridMapping
from gridslam.slam.full_slam import global_scan_refinement
from gridslam.slam.full_slam.global_scan_refinement import (
    Adjusted,
    Candidate,
    _Refinement,
    leave_to_search,
    place_components,
)
from gridslam.slam.full_slam.trajectory_score import TrajectoryScore
from gridslam.slam.loop_closure.constraints import Constraint, ConstraintSource
from gridslam.slam.loop_closure.key_graph import UNKNOWN_VARIANCES, KeyGraph
from gridslam.slam.loop_closure.loop_closure import LoopClosure
from gridslam.slam.loop_closure.state import LoopClosureState, RejectionReason
from gridslam.slam.loop_closure.submap_pairs import SubmapPairs
from gridslam.slam.pose_graph.pose_graph import PoseGraph

MAPPER = OccupancyGridMapping()


def candidate(name, height, constraints=(), weights=None):
    """Two poses, a metre apart."""
    poses = np.array([[0.0, height, 0.0], [1.0, height, 0.0]])
    chain = np.array([[0, 1], *((t.from_, t.to) for t in constraints)])
    told = np.array([[1.0, 0.0, 0.0], *(t.measurement for t in constraints)])
    graph = PoseGraph(poses, chain, told, np.tile(np.eye(3), (len(chain), 1, 1)), np.arange(len(chain)) < 1)
    return Candidate(name, graph, list(constraints), np.ones(len(chain)) if weights is None else np.array(weights))


def test_accepted_constraints_are_those_of_the_last_weights_and_recognized_ones_those_searched_for():
    constraints = [
        Constraint(0, 1, np.array([1.0, 0.0, 0.0]), np.eye(3), source, True)
        for source in (
            ConstraintSource.RECOGNIZED,
            ConstraintSource.TRACKED,
            ConstraintSource.PROXIMITY,
            ConstraintSource.RECOGNIZED,
        )
    ]
    one = candidate("closed 1", 0.0, constraints, [0.0, 0.9, 0.49, 0.5, 0.0])
    assert one.recognized_constraints == [constraints[0], constraints[3]]
    assert one.accepted_constraints == [constraints[0], constraints[2]]
    assert candidate("filter", 0.0, weights=[0.0]).accepted_constraints == []


def begin(with_gap=False):
    """A refinement of two key scans, with a gap in the laser data between them or without."""
    state = LoopClosureState()
    for variances in ((1e-4, 1e-4), (4.0 if with_gap else 1e-4, 1e-4)):
        state.graph.extend(np.zeros(3), np.zeros(3), variances)
    pairs = SubmapPairs()
    return _Refinement(state, None, None, MAPPER, LoopClosure(), lambda: None, [], 0, pairs, pairs)


def adjusted(one, likelihood):
    return Adjusted(one.graph, one.graph.edges[:0], 1e-4, score(likelihood), MAPPER.empty(1))


def score(likelihood):
    return TrajectoryScore(likelihood, 100, 0.8, -1.0)


@pytest.mark.parametrize(
    ("places", "height", "likelihood", "searches", "best", "kept"),
    [
        ((1, 1, 1), 0.0, -6.0, 1, "closed 1", None),  # they agree with the filter
        ((1, 1, 50), 0.0, -6.0, 1, "filter", (1, 1)),
        ((1, 1, 1), 2.0, -6.0, 1, "filter", (1, 1, 1)),  # they move it elsewhere
        ((1, 50, 50), 0.0, -6.0, 1, "filter", None),
        ((1, 1, 50), 0.0, -5.0, 1, "filter", (1, 1)),
        ((1, 1, 50), 0.0, -4.0, 3, "closed 3", None),
    ],
)
def test_what_changes_the_trajectory_is_compared_with_it(monkeypatch, places, height, likelihood, searches, best, kept):
    """The best candidate takes over the places that agree with it, which is no reason to search again."""
    found = [Constraint(0, 1, np.array([x, 0, 0]), np.eye(3), ConstraintSource.RECOGNIZED, True) for x in places]
    names, taken = [], []

    def add_closures(_, name, begin):
        names.append(name)
        return candidate(name, height, found)

    def keep_trajectory(_, name, poses, recognized):
        taken.append([int(constraint.measurement[0]) for constraint in recognized])
        return candidate(name, 0.0, recognized)

    def adjust(refinement, one):
        told = -5.0 if one.name == "filter" else likelihood + int(one.name[-1]) - 1
        refinement.adjusted[one.name] = adjusted(one, told)
        return refinement.adjusted[one.name]

    monkeypatch.setattr(_Refinement, "_add_closures", add_closures)
    monkeypatch.setattr(_Refinement, "_keep_trajectory", keep_trajectory)
    monkeypatch.setattr(_Refinement, "_optimize", lambda _, name, poses, constraints: candidate(name, 0.0, constraints))
    monkeypatch.setattr(_Refinement, "adjust", adjust)
    refinement = begin()
    assert refinement.select(np.zeros((2, 3))).name == best
    assert len(names) == searches
    assert "filter" in refinement.adjusted, "places are compared with the adjusted trajectory"
    assert taken[1:] == ([list(kept)] if kept else [])
    assert refinement.closure_state.rejected[RejectionReason.IMPLAUSIBLE] == (len(places) - len(kept) if kept else 0)


@pytest.mark.parametrize(
    ("height", "likelihood", "best"), [(0.2, -4.0, "filter"), (2.0, -4.0, "constraints"), (2.0, -6.0, "filter")]
)
def test_the_tracked_motion_with_the_constraints_of_the_drive_is_compared_where_it_differs(
    monkeypatch, height, likelihood, best
):
    """A filter can lose the right particle along a corridor that leaves a direction open."""

    def adjust(refinement, one):
        refinement.adjusted[one.name] = adjusted(one, -5.0 if one.name == "filter" else likelihood)
        return refinement.adjusted[one.name]

    monkeypatch.setattr(_Refinement, "_add_closures", lambda *_: None)
    monkeypatch.setattr(_Refinement, "_keep_trajectory", lambda _, name, *__: candidate(name, 0.0))
    monkeypatch.setattr(_Refinement, "_optimize", lambda _, name, *__: candidate(name, height))
    monkeypatch.setattr(_Refinement, "adjust", adjust)
    refinement = begin()
    assert refinement.select(np.zeros((2, 3))).name == best


@pytest.mark.parametrize(
    ("searched", "kept"),
    [
        (0, ["TRACKED 0 2", "RECOGNIZED 0 1", "TRACKED 0 1", "RECOGNIZED 0 4", "TRACKED 1 4"]),
        (4, None),
    ],
)
def test_places_recognized_across_a_gap_are_left_to_the_search_of_the_whole_log(searched, kept):
    """With what was tracked across a gap after them; not what joins drives or older scans."""
    graph = KeyGraph()
    for variances in ((1e-4, 1e-4), (1e-4, 1e-4), (4.0, 1e-4), (1e-4, 1e-4), UNKNOWN_VARIANCES):
        graph.extend(np.zeros(3), np.zeros(3), variances)
    said = "TRACKED 0 2,RECOGNIZED 0 1,RECOGNIZED 1 3,TRACKED 1 2,TRACKED 0 1,RECOGNIZED 0 4,TRACKED 1 4"
    for source, from_, to in (each.split() for each in said.split(",")):
        pair = int(from_), int(to)
        graph.add(Constraint(*pair, np.zeros(3), np.eye(3), ConstraintSource[source], True))
    left = [f"{c.source.name} {c.from_} {c.to}" for c in leave_to_search(graph, searched)]
    assert left == (said.split(",") if kept is None else kept)


@pytest.mark.parametrize(("apart", "best"), [(-4.0, 1), (-6.0, 0)])
def test_components_that_nothing_joins_may_lie_apart_or_not(monkeypatch, apart, best):
    """A filter has often matched them to its map, but along a corridor they fit anywhere."""

    def adjust(_, measured, before, components):
        told = score(apart if components.any() else -5.0)
        return Adjusted(measured, np.array([components]), 1e-4, told, MAPPER.empty(1))

    monkeypatch.setattr(_Refinement, "_measured", lambda _, one: one.graph)
    monkeypatch.setattr(_Refinement, "_adjust", adjust)
    refinement = begin(with_gap=True)
    found = refinement.adjust(candidate("filter", 0.0))
    assert found.pairs.tolist() == [[0, best]]
    assert refinement.adjust(candidate("filter", 0.0)) is found


def test_a_component_that_nothing_joins_keeps_its_shape_and_lies_where_most_of_its_poses_were():
    """Its first pose, before the map told, was off by 2 m and turned; the first component was moved, and it with it."""
    rng = np.random.default_rng(5)
    components = np.repeat([0, 1, 0, 3], 8)
    truth = np.stack([np.arange(32.0), rng.normal(size=32), rng.uniform(-3, 3, size=32)], -1)
    before = truth.copy()
    before[8] += [0.0, 2.0, 0.1]
    adjusted = truth.copy()
    adjusted[8:16] = compose(np.array([1.0, -3.0, 0.4]), truth[8:16])
    adjusted[24:] = compose(np.array([-2.0, 1.0, -0.7]), truth[24:])
    moved = np.array([0.3, 0.2, 0.1])
    adjusted[components == 0] = compose(moved, truth[components == 0])
    edges = np.stack([np.arange(31), np.arange(1, 32)], -1)
    graph = PoseGraph.of(adjusted, edges, between(adjusted[:-1], adjusted[1:]), np.tile(np.eye(3), (31, 1, 1)))
    found = place_components(graph, before, components)
    np.testing.assert_allclose(between(found.poses, compose(moved, truth)), 0, atol=1e-9)
    np.testing.assert_allclose(found.errors(), 0, atol=1e-9)


def test_a_place_that_joins_components_and_is_rejected_is_not_searched_for_again(monkeypatch):
    """It would be found and rejected for ever."""
    found = [
        Constraint(0, 1, np.array([x, 0, 0]), np.eye(3), ConstraintSource.RECOGNIZED, joins)
        for x, joins in ((1, False), (1, False), (50, True))
    ]
    names = []

    def add_closures(refinement, name, begin):
        names.append(name)
        assert len(names) < 10
        refinement.graph.constraints = found
        return candidate(name, 0.0, found)

    def keep_trajectory(refinement, name, poses, recognized):
        refinement.graph.constraints = recognized
        return candidate(name, 0.0, recognized)

    def adjust(refinement, one):
        refinement.adjusted[one.name] = adjusted(one, -5.0 if one.name == "filter" else -6.0)
        return refinement.adjusted[one.name]

    monkeypatch.setattr(_Refinement, "_add_closures", add_closures)
    monkeypatch.setattr(_Refinement, "_keep_trajectory", keep_trajectory)
    monkeypatch.setattr(_Refinement, "_optimize", lambda _, name, poses, constraints: candidate(name, 0.0, constraints))
    monkeypatch.setattr(_Refinement, "adjust", adjust)
    refinement = begin(with_gap=True)
    assert refinement.select(np.zeros((2, 3))).recognized_constraints == found[:2]
    assert len(names) == 1


def test_places_are_compared_with_the_adjusted_trajectory(monkeypatch):
    """The filter has drifted by 2 m where the places are; its surfaces fit only there."""
    found = [Constraint(0, 1, np.array([1.0, 2.0, 0]), 1e6 * np.eye(3), ConstraintSource.RECOGNIZED, True)] * 3
    there = candidate("there", 0.0).graph.with_poses(np.array([[0.0, 0.0, 0.0], [1.0, 2.0, 0.0]]))

    def adjust(refinement, one):
        refinement.adjusted[one.name] = adjusted(one, -5.0)._replace(graph=there)
        return refinement.adjusted[one.name]

    monkeypatch.setattr(_Refinement, "_add_closures", lambda _, name, begin: candidate(name, 0.0, found))
    monkeypatch.setattr(_Refinement, "_optimize", lambda _, name, poses, constraints: candidate(name, 0.0, constraints))
    monkeypatch.setattr(_Refinement, "adjust", adjust)
    assert begin().select(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])).recognized_constraints == found


@pytest.mark.parametrize(
    ("away", "likelihood", "is_better"), [(0.2, -4.0, False), (2.0, -4.0, True), (2.0, -6.0, False)]
)
@pytest.mark.parametrize(("proposed", "name"), [("propose_alignments", "placed 1"), ("propose_revisits", "revisits")])
def test_what_is_proposed_must_change_the_trajectory_and_score_better(
    monkeypatch, away, likelihood, is_better, proposed, name
):
    """Neither place recognition nor the filter has found where a component, or the last metres, belong."""
    place = Constraint(0, 1, np.array([1.0, away, 0.0]), 1e6 * np.eye(3), ConstraintSource.RECOGNIZED, True)
    for each in ("propose_alignments", "propose_revisits"):
        monkeypatch.setattr(global_scan_refinement, each, lambda *_, each=each: [place] if each == proposed else [])

    def adjust(refinement, one):
        refinement.adjusted[one.name] = adjusted(one, -5.0 if one.name == "filter" else likelihood)
        return refinement.adjusted[one.name]

    monkeypatch.setattr(_Refinement, "_add_closures", lambda *_: None)
    monkeypatch.setattr(_Refinement, "_optimize", lambda _, name, *__: candidate(name, 0.0))
    monkeypatch.setattr(_Refinement, "adjust", adjust)
    selected = begin(with_gap=True).select(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]))
    assert selected.name == (name if is_better else "filter")
    assert selected.constraints == []
    assert selected.graph.poses[1, 1] == pytest.approx(away if is_better else 0.0, abs=0.01)
